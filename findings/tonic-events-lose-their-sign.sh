#!/usr/bin/env bash
# A good guess: Tonic's transforms keep what its page says of an event camera's events: a voxel grid adds positive events and takes away negative
# ones, jitter has the mean 0, boxes to be left out have the sides asked for. Found: in Tonic's own arrays polarities are booleans, of which
# its voxel grid makes -1 that is True: negative events count as positive ones. Jitter moves events by half a pixel to the upper left in the
# mean. Boxes of 0.1 to 0.2 of the sides are of 0.2 to 1. And 70,000 events of a pixel are 4463 in a frame.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check --no-deps tonic==1.7.0 importRosbag==1.0.4 tqdm==4.70.1 typing_extensions==4.16.0
v/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 scipy==1.17.1 h5py==3.16.0 requests==2.34.2
v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
from tonic import transforms
from tonic.io import make_structured_array

print("Tonic", version("tonic"))
draw = np.random.default_rng(0)
np.random.seed(0)
number = 1000
places, times = draw.integers(0, 20, (2, number)), np.sort(draw.integers(0, 100000, number))
grid = transforms.ToVoxelGrid(sensor_size=(20, 20, 2), n_time_bins=5)
sums = {}
for polarity in (0, 1):
    events = make_structured_array(*places, times, np.full(number, polarity))
    numbers = np.zeros(number, [("x", "i2"), ("y", "i2"), ("t", "i8"), ("p", "i1")])
    for name in numbers.dtype.names:
        numbers[name] = events[name]
    sums[polarity] = [round(float(grid(kind).sum()), 1) for kind in (events, numbers)]
print("sums of voxel grids by polarity, of Tonic's arrays", events.dtype["p"], "and with whole numbers:", sums)
assert sums[0][0] == sums[1][0] == sums[1][1] > 800 and sums[0][1] == -sums[1][1], "voxels: the behaviour has changed"

still = make_structured_array(*np.full((2, 100000), 100), np.arange(100000), np.ones(100000))
moved = transforms.SpatialJitter(sensor_size=(200, 200, 2), var_x=1, var_y=1)(still)
mean = moved["x"].mean() - 100, moved["y"].mean() - 100
print(f"mean of jitter: {mean[0]:.3f} {mean[1]:.3f}")
assert abs(mean[0] + 0.5) < 0.02 and abs(mean[1] + 0.5) < 0.02, "jitter: the behaviour has changed"

whole = make_structured_array(*np.mgrid[:100, :100].reshape(2, -1), np.arange(10000), np.ones(10000))
left_out = transforms.DropEventByArea(sensor_size=(100, 100, 2), area_ratio=(0.1, 0.2))
sides = [np.sqrt(1 - len(left_out(whole)) / 10000) for _ in range(300)]
print(f"sides of boxes that are left out: {min(sides):.2f} to {max(sides):.2f}")
assert min(sides) >= 0.19 and max(sides) > 0.9, "boxes: the behaviour has changed"

pixel = make_structured_array(*np.zeros((2, 70000)), np.arange(70000), np.ones(70000))
frame = transforms.ToFrame(sensor_size=(2, 2, 2), n_time_bins=1)(pixel)
print("70,000 events of one pixel in a frame:", frame.max(), frame.dtype)
assert frame.max() == 4463, "frames: the behaviour has changed"
PY
