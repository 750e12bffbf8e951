#!/usr/bin/env bash
# A good guess: cv2.IMREAD_UNCHANGED gives the numbers of a TIFF as they are stored, unturned, in every function that reads.
# Found: for a TIFF whose tag of orientation says 6 (a quarter turn), cv2.imdecodemulti turns the picture whatever the
# flag, so that rows and columns change places, and cv2.imread gives None with an internal error. tifffile and MATLAB
# give the numbers as stored: masks computed there lie across the picture that OpenCV reads.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 tifffile==2026.3.3 numpy==2.4.6
cd "$folder"
venv/bin/python - 2>/dev/null <<'PY'
import cv2
import numpy as np
import tifffile

print("opencv", cv2.__version__, "tifffile", tifffile.__version__)
stored = np.arange(12 * 20, dtype=np.uint16).reshape(12, 20)
tifffile.imwrite("a.tif", stored, extratags=[(274, "H", 1, 6, True)])
_, pages = cv2.imdecodemulti(np.fromfile("a.tif", np.uint8), cv2.IMREAD_UNCHANGED)
single = cv2.imread("a.tif", cv2.IMREAD_UNCHANGED)
print("tifffile", tifffile.imread("a.tif").shape, "imdecodemulti", pages[0].shape, "imread", single)
assert np.array_equal(pages[0], np.rot90(stored, -1)) and single is None, "the behaviour has changed"
PY
