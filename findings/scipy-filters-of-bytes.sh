#!/usr/bin/env bash
# A good guess: SciPy's gaussian_filter and uniform_filter of a picture of bytes are those of the same picture in floating point, rounded:
# skimage and OpenCV keep the mean. Found: the result has the picture's type, and after each axis digits are cut off: a Gaussian makes a
# picture one level darker, ten times it ten levels, each further axis of a stack half a level more, signed numbers move towards zero,
# and what a derivative has below zero wraps. Shifts and zooms of the same package do round.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check scipy==1.17.1 numpy==2.4.6 opencv-python-headless==5.0.0.93
v/bin/python - <<'PY'
import cv2
import numpy as np
import scipy
from scipy import ndimage

picture = np.random.default_rng(7).integers(0, 256, (256, 256)).astype(np.uint8)
stack = np.random.default_rng(8).integers(0, 256, (40, 40, 40)).astype(np.uint8)


def brighter(function, values):
    return round(float((function(values) - function(values.astype(float))).mean()), 2)


def gauss(values):
    return ndimage.gaussian_filter(values, 1)


again = picture
for _ in range(10):
    again = gauss(again)
seen = {
    "gauss": brighter(gauss, picture),
    "gauss of a stack": brighter(gauss, stack),
    "box": brighter(lambda values: ndimage.uniform_filter(values, 3), picture),
    "ten times": round(float(again.mean() - picture.mean()), 1),
    "signed": brighter(gauss, picture.astype(np.int16) - 255),
    "shift": brighter(lambda values: ndimage.shift(values, 0.3, order=1), picture),
    "OpenCV": brighter(lambda values: cv2.GaussianBlur(values, (0, 0), 1), picture),
}
edge = ndimage.gaussian_filter1d(np.uint8([200] * 8 + [100] * 8), 1, order=1)
print("scipy", scipy.__version__, "brighter by", seen, "derivative of an edge down", edge)
assert -1.05 < seen["gauss"] < -0.9 and seen["gauss of a stack"] < -1.4 and seen["box"] < -0.6, "bytes: the behaviour has changed"
assert seen["ten times"] < -9 and seen["signed"] > 0.9, "repeats and signs: the behaviour has changed"
assert abs(seen["shift"]) < 0.05 and abs(seen["OpenCV"]) < 0.05, "what is right has changed"
assert edge.max() > 200, "derivatives: the behaviour has changed"
PY
