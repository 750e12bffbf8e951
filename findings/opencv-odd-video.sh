#!/usr/bin/env bash
# OpenCV's VideoWriter, opened for 33 x 25 pixels in VP9, says that it is open, takes frames of 33 x 25, and writes a film of
# 32 x 24: the last row and column are gone without a word. A good guess: VP9 knows odd sizes, so they are kept, or
# `isOpened()` is False.
set -euo pipefail
place=$(mktemp -d); trap 'rm -rf "$place"' EXIT; cd "$place"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 opencv-contrib-python-headless==5.0.0.93
v/bin/python - <<'PY'
import sys
import cv2, numpy as np
print("opencv-contrib-python-headless", cv2.__version__)
writer = cv2.VideoWriter("film.mp4", cv2.VideoWriter.fourcc(*"vp09"), 24, (33, 25))
opened = writer.isOpened()
for _ in range(5):
    writer.write(np.full((25, 33, 3), 200, np.uint8))
writer.release()
film = cv2.VideoCapture("film.mp4")
size = film.get(cv2.CAP_PROP_FRAME_WIDTH), film.get(cv2.CAP_PROP_FRAME_HEIGHT)
print("asked for 33 x 25, opened:", opened, "- written:", size, film.get(cv2.CAP_PROP_FRAME_COUNT), "frames")
sys.exit(not (opened and size == (32.0, 24.0)))
PY
