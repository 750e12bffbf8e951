#!/usr/bin/env bash
# A good guess: pycolmap's interpolate_camera_poses() leaves a camera that turns on the spot where it is, and leads one between two places along the line between them. Found: it
# interpolates translations of the poses, which are those of the world as the camera sees it: a camera 10 m from the origin that turns by a quarter goes 2.93 m
# towards the origin meanwhile, and one of 170 degrees 9.1 m. A stage's path, interpolated between two calibrated frames, bends towards wherever the origin happens to be.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pycolmap==4.2.1 numpy==2.3.5 scipy==1.17.1
v/bin/python - <<'PY'
import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation


def pose(centre, degrees):
    turn = Rotation.from_euler("y", degrees, degrees=True)
    return pycolmap.Rigid3d(pycolmap.Rotation3d(turn.as_quat()), -turn.apply(centre))


def midway(first, second):
    between = pycolmap.interpolate_camera_poses(first, second, 0.5)
    return between.inverse().translation, np.degrees(Rotation.from_quat(between.rotation.quat).magnitude())


place = np.array([10.0, 0, 0])
moved = {}
for degrees in (0, 30, 90, 170):
    centre, turned = midway(pose(place, 0), pose(place, degrees))
    moved[degrees] = float(np.linalg.norm(centre - place))
    assert abs(turned - degrees / 2) < 1e-6
rail, _ = midway(pose(np.array([10.0, 0, 0]), 0), pose(np.array([12.0, 0, 0]), 30))
print("pycolmap", pycolmap.__version__, "a camera at", place, "turns on the spot by degrees, and is off midway by", {k: round(v, 3) for k, v in moved.items()})
print("midway on a rail from x = 10 to 12 m, turning by 30 degrees:", rail.round(3))
assert moved[0] < 1e-9
assert [round(moved[degrees], 2) for degrees in (30, 90, 170)] == [0.34, 2.93, 9.13], "the behaviour has changed"
assert abs(rail[2]) > 0.2, "the behaviour has changed"
PY
