#!/usr/bin/env bash
# A good guess: the box filter of OpenCV leaves a plain picture as it is, and rounds means of bytes to the nearest. Found: of areas that
# are powers of two, 2 x 1, 2 x 2, 4 x 1, 4 x 4 …, half an area and one more is added before the division: a mean of two
# bytes is a level too bright even where it is whole, so that a plain 10 becomes 11 and a plain 255 becomes 0 in places (256, wrapped);
# of 2 x 2 all means are rounded up. OpenCV 4 and 5 both; 3 x 3, 16-bit and floating pictures are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
cat >blur.py <<'PY'
import cv2
import numpy as np

plain = {}
for value in (10, 254, 255):
    picture = np.full((40, 50), value, np.uint8)
    plain[value] = [np.unique(cv2.blur(picture, size)).tolist() for size in ((2, 1), (1, 2), (2, 2), (3, 3))]
print("opencv", cv2.__version__, "plain pictures by 2 x 1, 1 x 2, 2 x 2, 3 x 3:", plain)
picture = np.random.default_rng(7).integers(0, 200, (256, 256)).astype(np.uint8)
brighter = {}
for size in ((2, 1), (2, 2), (4, 1), (3, 3)):
    difference = cv2.blur(picture, size) - cv2.blur(picture.astype(float), size)
    brighter[size] = round(float(difference.mean()), 2), round(float(difference.max()), 2)
wide = picture.astype(np.uint16) * 257
of_16_bits = float((cv2.blur(wide, (2, 1)) - cv2.blur(wide.astype(float), (2, 1))).max())
print("brighter in the mean by, at most by", brighter, "of 16 bits at most by", of_16_bits)
for value in (10, 254):
    assert plain[value] == [[value + 1]] * 2 + [[value]] * 2, "plain pictures: the behaviour has changed"
assert 0 in plain[255][0] and plain[255][2:] == [[255]] * 2, "white: the behaviour has changed"
assert brighter[2, 1] == (0.75, 1.0) and 0.36 < brighter[2, 2][0] < 0.39 and brighter[4, 1][1] == 0.75, "means: the behaviour has changed"
assert abs(brighter[3, 3][0]) < 0.01 and of_16_bits <= 0.5, "what is right has changed"
PY
python3 -m venv old; old/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==4.13.0.92 numpy==2.4.6
python3 -m venv new; new/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 numpy==2.4.6
old/bin/python blur.py
new/bin/python blur.py
