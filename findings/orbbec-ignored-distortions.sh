#!/usr/bin/env bash
# A good guess: Orbbec's SDK projects points with the distortion that its record names: Brown and Conrady's, with six radial terms, inverse, or
# a fisheye's. Found: with Brown and Conrady's alone; all others, that with six terms too, are no distortion at all, in silence: 53 pixels from
# where the point is, of 640.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pyorbbecsdk2==2.1.2 opencv-python-headless==4.11.0.86 numpy==1.26.4
v/bin/python - <<'PY'
from importlib.metadata import version

import cv2
import numpy as np
import pyorbbecsdk as orbbec

camera, lens, where, point = orbbec.OBCameraIntrinsic(), orbbec.OBCameraDistortion(), orbbec.OBExtrinsic(), orbbec.OBPoint3f(500, 300, 1000)
camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height = 500, 500, 320, 240, 640, 480
where.rot, where.transform = np.eye(3, dtype=np.float32), np.zeros(3, np.float32)
lens.k1, lens.k2 = 0.5, 0.1
matrix = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
truth = cv2.projectPoints(np.array([[500.0, 300, 1000]]), np.zeros(3), np.zeros(3), matrix, np.array([0.5, 0.1, 0, 0, 0, 0, 0, 0]))[0].ravel()
found = {}
for name, model in orbbec.OBCameraDistortionModel.__members__.items():
    lens.model = model
    seen = orbbec.transformation3dto2d(point, camera, lens, where)
    found[name] = (round(seen.x, 1), round(seen.y, 1))
print("pyorbbecsdk2", version("pyorbbecsdk2"), "OpenCV, Brown and Conrady:", np.round(truth, 1), "Orbbec:", found)
plain = [name for name, seen in found.items() if seen == (570.0, 390.0)]
others = ["NONE", "MODIFIED_BROWN_CONRADY", "INVERSE_BROWN_CONRADY", "BROWN_CONRADY_K6", "KANNALA_BRANDT4"]
assert np.allclose(found["BROWN_CONRADY"], truth, atol=0.1) and sorted(plain) == sorted(others), "the behaviour has changed"
PY
