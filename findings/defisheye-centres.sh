#!/usr/bin/env bash
# A good guess: defisheye's xcenter and ycenter are where the fisheye's circle lies in the given picture, angle turns the picture, as its page says, and a
# picture's middle stays its middle. Found: both count in a square that was cut out of the middle before: with the circle's true centre, (320, 240) of
# 640 x 480, a lamp on the axis lies 80 pixels beside the centre of the result, and at it without naming one. angle does nothing. The centre's own
# pixel is the upper left corner of the picture: a black dot in each result.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check opencv-python-headless==5.0.0.93 numpy==2.4.6
v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps defisheye==1.4.1
OMP_NUM_THREADS=1 v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
from defisheye import Defisheye

own = version("defisheye")
rows, columns = np.mgrid[:480, :640]
lamp = np.exp(-((columns - 320) ** 2 + (rows - 240) ** 2) / 2 / 6**2)[..., None] * 255
picture = np.repeat(lamp, 3, axis=2).astype(np.uint8)
kind = {"dtype": "linear", "format": "circular", "fov": 180, "pfov": 120}
found = {}
for name, centre in (("none named", {}), ("320, 240", {"xcenter": 320, "ycenter": 240}), ("240, 240", {"xcenter": 240, "ycenter": 240})):
    result = Defisheye(picture, **kind, **centre).convert()[..., 0].astype(float)
    middle = centre.get("xcenter", 239), centre.get("ycenter", 239)
    light = result[..., None] * np.stack(np.mgrid[: result.shape[0], : result.shape[1]][::-1], axis=-1)
    found[name] = (light.sum((0, 1)) / result.sum() - middle).round(1).tolist(), result[middle[1], middle[0]]
    print("defisheye", own, f"a lamp at (320, 240) of 640 x 480, centre {name}: it lies {found[name][0]} from the centre of the result of", result.shape, "whose own pixel is", found[name][1])
steep = np.repeat((columns / 640 * 250).astype(np.uint8)[..., None], 3, axis=2)
turned = [Defisheye(steep, **kind, angle=angle).convert() for angle in (0, 90)]
print("turning by 90 degrees changes a ramp by", int(np.abs(turned[0].astype(int) - turned[1]).max()))
white = Defisheye(np.pad(np.full((478, 638, 3), 200, np.uint8), ((1, 1), (1, 1), (0, 0))), **kind).convert()[..., 0]
print("a white picture with a black border has at its centre", white[238:241, 238:241].tolist())
assert all(abs(each) < 1.5 for name in ("none named", "240, 240") for each in found[name][0])
assert abs(abs(found["320, 240"][0][0]) - 80) < 20 and abs(found["320, 240"][0][1]) < 1.5, "centres: the behaviour has changed"
assert np.array_equal(*turned), "angle: the behaviour has changed"
assert white[239, 239] == 0 and (np.delete(white[238:241, 238:241].ravel(), 4) == 200).all(), "the centre's pixel: the behaviour has changed"
PY
