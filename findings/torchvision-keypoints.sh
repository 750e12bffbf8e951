#!/usr/bin/env bash
# A good guess: torchvision's KeyPoints go where the picture's content goes under every transform, with whole numbers either at the pixels' centres or
# at their corners, always the same. Found: flips take them for centres (of 60 columns 25 becomes 34), rotation, scaling and resizing for corners
# (turned by 90 degrees in 40 rows, 15 becomes 25, where the spot lies at 24; in the doubled picture 25 becomes 50, where it lies at 50.5).
# A half turn and two flips are the same picture, and keypoints a whole pixel apart in both axes; no offset put on beforehand mends both.
# Boxes are corners throughout. A turned and expanded picture has also another size than its keypoints say: 66 x 72, 65 x 72.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check torchvision==0.29.1 torch==2.14.1 numpy==2.4.6
v/bin/python -W ignore - <<'PY'
import torch
import torchvision
from torchvision.transforms.v2 import functional as F
from torchvision.tv_tensors import BoundingBoxes, Image, KeyPoints

HEIGHT, WIDTH, X, Y = 40, 60, 25.0, 15.0


def centre(picture):
    """The centroid of a bright spot, whole numbers at the pixels' centres."""
    weights = picture[0] / picture[0].sum()
    return [round(float((weights.sum(axis) * torch.arange(weights.shape[1 - axis])).sum()), 2) for axis in (0, 1)]


rows, columns = torch.meshgrid(torch.arange(HEIGHT), torch.arange(WIDTH), indexing="ij")
spot = Image(torch.exp(-((columns - X) ** 2 + (rows - Y) ** 2) / 12.5).double()[None])
key = KeyPoints(torch.tensor([[X, Y]]), canvas_size=(HEIGHT, WIDTH))
box = BoundingBoxes(torch.tensor([[X - 2.5, Y - 2.5, X + 3.5, Y + 3.5]]), format="XYXY", canvas_size=(HEIGHT, WIDTH))
assert centre(spot) == [X, Y]
off, boxes = {}, {}
for name, change in {
    "flips": lambda one: F.vertical_flip(F.horizontal_flip(one)),
    "half turn": lambda one: F.rotate(one, 180),
    "90 degrees": lambda one: F.rotate(one, 90),
    "doubled": lambda one: F.resize(one, [2 * HEIGHT, 2 * WIDTH]),
}.items():
    true, moved, around = centre(change(spot)), change(key)[0].tolist(), change(box)[0].tolist()
    off[name] = [round(there - here, 1) for there, here in zip(moved, true)]
    boxes[name] = [round((around[i] + around[i + 2]) / 2 - 0.5 - true[i], 1) for i in (0, 1)]
sizes = [tuple(F.rotate(spot, 30, expand=True).shape[1:]), F.rotate(key, 30, expand=True).canvas_size]
print("torchvision", torchvision.__version__, "keypoints beside the spot", off, "centres of boxes", boxes, "sizes after 30 degrees", sizes)
assert off["flips"] == [0, 0], "flips: the behaviour has changed"
assert off["half turn"] == [1, 1] and off["90 degrees"] == [0, 1], "rotation: the behaviour has changed"
assert off["doubled"] == [-0.5, -0.5], "resizing: the behaviour has changed"
assert all(one == [0, 0] for one in boxes.values()), "boxes: the behaviour has changed"
assert sizes == [(66, 72), (65, 72)], "sizes: the behaviour has changed"
PY
