#!/usr/bin/env bash
# A good guess: a trimesh camera keeps its size in pixels when it is given a calibrated intrinsic matrix, and its rays' pixels count rows from
# the top, as the matrix does. Found: the size becomes twice the principal point: 640 x 480 with a centre at (300, 200) is 600 x 400, with as
# many rays; and rows are counted from below.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check trimesh==5.2.0 numpy==2.4.6
v/bin/python - <<'PY'
import numpy as np
import trimesh
from trimesh.scene.cameras import Camera

camera = Camera(resolution=(640, 480), focal=(500, 500))
camera.K = np.array([[500, 0, 300], [0, 500, 200], [0, 0, 1]])
small = Camera(resolution=(4, 3), focal=(2, 2))
directions, pixels = small.to_rays()
highest = directions[:, 1] > 0  # cameras of trimesh look along -z, y is up
print("trimesh", trimesh.__version__, "640 x 480 becomes", camera.resolution.tolist(), "rows of rays that look up", set(pixels[highest, 1].tolist()))
assert camera.resolution.tolist() == [600, 400] and set(pixels[highest, 1].tolist()) == {2}, "the behaviour has changed"
PY
