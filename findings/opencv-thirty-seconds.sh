#!/usr/bin/env bash
# A good guess: OpenCV moves a floating picture by a hundredth of a pixel, linearly, if warpAffine, warpPerspective or remap are told to.
# Found: OpenCV 4 rounds places to 1/32 of a pixel before it interpolates, whatever the type of the picture: a
# shift by 0.01 px is none, one by 0.3 is 0.3125, and a residue by which a stage's steps are measured has steps of its own. getRectSubPix
# does not. OpenCV 5 interpolates at the very place: the same pipeline gives other figures.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
cat >shift.py <<'PY'
import cv2
import numpy as np

columns = np.arange(64, dtype=np.float32)
ramp = np.tile(columns, (64, 1))
x, y = np.meshgrid(columns, columns)
shifts = np.float32([0.01, 0.02, 0.1, 0.3])


def moved(shift):
    matrix = np.float32([[1, 0, shift], [0, 1, 0], [0, 0, 1]])
    yield cv2.warpAffine(ramp, matrix[:2], (64, 64))
    yield cv2.warpPerspective(ramp, matrix, (64, 64))
    yield cv2.remap(ramp, x - shift, y, cv2.INTER_LINEAR)


seen = np.array([[32 - float(picture[32, 32]) for picture in moved(shift)] for shift in shifts])
patch = [32 - float(cv2.getRectSubPix(ramp, (1, 1), (32 - float(shift), 32.0))[0, 0]) for shift in shifts]
print("opencv", cv2.__version__, "asked", shifts, "moved by", *seen.T.round(4).tolist(), "getRectSubPix", np.round(patch, 4))
steps = np.rint(shifts * 32) / 32 if cv2.__version__.startswith("4") else shifts
assert np.allclose(seen, steps[:, None], atol=1e-4), "steps: the behaviour has changed"
assert np.allclose(patch, shifts, atol=1e-4), "getRectSubPix has changed"
PY
python3 -m venv old; old/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==4.13.0.92 numpy==2.4.6
python3 -m venv new; new/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 numpy==2.4.6
old/bin/python shift.py
new/bin/python shift.py
