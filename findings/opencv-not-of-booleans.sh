#!/usr/bin/env bash
# OpenCV 5 takes NumPy's booleans, which 4 refused. A good guess: `bitwise_not` of a mask is its opposite, or an error as most functions
# raise for booleans. Found: an array of booleans that are all true: its bytes are 254 and 255, which no boolean should be, so that
# the opposite of a mask is everything, and NumPy and OpenCV both count every element.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 opencv-python-headless==5.0.0.93
v/bin/python - <<'PY'
import cv2
import numpy as np

mask = np.array([[True, False, True], [False, True, True]])
turned = cv2.bitwise_not(mask)
counted = int(turned.sum()), cv2.countNonZero(turned)
print("OpenCV", cv2.__version__, "of", int(mask.sum()), "open elements the opposite has", counted, turned.dtype, turned.view(np.uint8).tolist())
assert turned.dtype == bool and counted == (6, 6) and set(turned.view(np.uint8).ravel().tolist()) == {254, 255}, "the behaviour has changed"
PY
