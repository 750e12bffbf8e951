#!/usr/bin/env bash
# A good guess: `kappa`, the distortion parameter of pytransform3d's camera, multiplies, as OpenCV's k1 and COLMAP's k do: a point at
# distance r from the axis is seen at r (1 + kappa r^2). Found: it is seen at r / (1 + kappa r^2), so a calibration's k1
# bends the picture the other way: of a lens with k1 = 0.1 a point at r = 0.56 is 3 % too near to the middle instead of 3 %
# too far, and at r above 1 / sqrt(kappa) points come back towards the middle.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pytransform3d==3.17.0 opencv-python-headless==5.0.0.93 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import cv2
import numpy as np
from pytransform3d.camera import cam2sensor

point = np.array([[1.0, 0.5, 2.0]])
radius = float(np.hypot(*point[0, :2] / 2))
scale = {}
for kappa in (-0.1, 0.1):
    ours = cam2sensor(np.c_[point, [1.0]], 1.0, kappa)
    theirs, _ = cv2.projectPoints(point, np.zeros(3), np.zeros(3), np.eye(3), np.array([kappa, 0, 0, 0.0]))
    scale[kappa] = [round(float(np.hypot(*np.ravel(seen)) / radius), 4) for seen in (ours, theirs)]
far = [float(cam2sensor(np.array([[x, 0, 1.0, 1.0]]), 1.0, 0.1)[0, 0]) for x in (3.0, 4.0)]
print("pytransform3d", version("pytransform3d"), "r", round(radius, 3), "kappa: scale here, by OpenCV", scale)
print("points at 3 and 4 are seen at", [round(x, 3) for x in far])
divided = [round(1 / (1 + kappa * radius**2), 4) for kappa in (-0.1, 0.1)]
assert [scale[-0.1][0], scale[0.1][0]] == divided, "kappa: the behaviour has changed"
assert scale[0.1][1] > 1 > scale[0.1][0], "the other direction has changed"
assert far[1] < far[0], "far points: the behaviour has changed"
PY
