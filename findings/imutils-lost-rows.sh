#!/usr/bin/env bash
# A good guess: rotate_bound() of imutils, which is there so that no part of a picture is cut off, turns by 90, 180 and 270 degrees as np.rot90 does, and
# resize(width=328) of 640 x 480 pixels has 246 rows. Found: turned pictures lie a pixel too far right, down or both, a column or row of
# black comes in and the last one is lost, since the centre is taken at half the size, not at half a pixel less; rotate() does so by 180 degrees;
# and sizes are cut: 245 rows, where the exact number is whole.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check imutils==0.5.4 numpy==2.4.6 opencv-python-headless==5.0.0.93
v/bin/python - <<'PY'
from importlib.metadata import version

import imutils
import numpy as np

picture = np.arange(1, 25, dtype=np.uint8).reshape(4, 6)
lost = {}
for degrees in (90, 180, 270):
    turned, right = imutils.rotate_bound(picture, degrees), np.rot90(picture, -degrees // 90)
    lost[degrees] = sorted(set(picture.ravel().tolist()) - set(turned.ravel().tolist()))
    print("imutils", version("imutils"), degrees, "degrees:", turned.tolist(), "lost", lost[degrees], "right", right.tolist())
    assert turned.shape == right.shape
rows = {width: imutils.resize(np.zeros((480, 640), np.uint8), width=width).shape[0] for width in (320, 328)}
print("rows of 640 x 480 by width:", rows)
assert {degrees: len(values) for degrees, values in lost.items()} == {90: 6, 180: 9, 270: 4}, "turns: the behaviour has changed"
assert (imutils.rotate_bound(picture, 180)[1:, 1:] == np.rot90(picture, 2)[:-1, :-1]).all()
assert (imutils.rotate(picture, 180)[0] == 0).all(), "rotate: the behaviour has changed"
assert rows == {320: 240, 328: 245}, "sizes: the behaviour has changed"
PY
