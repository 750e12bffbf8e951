#!/usr/bin/env bash
# A good guess: OpenCV 5 treats a NumPy array of one axis as OpenCV 4 did, or refuses it. Found: 4 took it for a column, 5 takes it
# for a row, without a word. A window of one row and three columns leaves a signal as it is in 4 and smooths it in 5, one of three
# rows the other way round; sorting "every row" did nothing and now sorts; `minMaxLoc` says (x, y) = (0, 1), then (1, 0).
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
cat >flat.py <<'PY'
import sys

import cv2
import numpy as np

signal = np.float32([0, 0, 9, 0, 0])
along_x = cv2.blur(signal, (3, 1)).ravel().tolist()
along_y = cv2.blur(signal, (1, 3)).ravel().tolist()
ordered = cv2.sort(np.float32([3, 1, 2]), cv2.SORT_EVERY_ROW + cv2.SORT_ASCENDING).ravel().tolist()
place = cv2.minMaxLoc(np.float32([3, 1, 2]))[2]
shape = cv2.add(signal, signal).shape
print("OpenCV", cv2.__version__, "3 x 1:", along_x, " 1 x 3:", along_y, " sorted:", ordered, " least at", place, " sum's shape", shape)
smooth, same = [0, 3, 3, 3, 0], signal.tolist()
four = along_x == same and along_y == smooth and ordered == [3, 1, 2] and place == (0, 1) and shape == (5, 1)
five = along_x == smooth and along_y == same and ordered == [1, 2, 3] and place == (1, 0) and shape == (5,)
assert four if sys.argv[1] == "4" else five, "the behaviour has changed"
PY
python3 -m venv v4; v4/bin/pip install --quiet --disable-pip-version-check numpy==2.2.6 opencv-python-headless==4.12.0.88
python3 -m venv v5; v5/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 opencv-python-headless==5.0.0.93
v4/bin/python flat.py 4
v5/bin/python flat.py 5
