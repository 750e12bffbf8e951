#!/usr/bin/env bash
# A good guess: cv2.imread(..., cv2.IMREAD_UNCHANGED) returns the numbers of a TIFF as they are stored.
# Found: numbers of 10, 12 and 14 bits come back times 64, 16 and 4, in a uint16 that looks like the camera's own; a page
# of 4 bits in another encoder's padding likewise. Nothing in the result tells.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet opencv-python-headless==5.0.0.93 tifffile==2026.3.3 imagecodecs==2026.3.6 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PY'
import cv2
import numpy as np
import tifffile

print("opencv", cv2.__version__, "tifffile", tifffile.__version__)
seen = {}
for bits in (10, 12, 14):
    stored = (np.arange(12 * 20).reshape(12, 20) * 17 % 2**bits).astype(np.uint16)
    tifffile.imwrite("a.tif", stored, bitspersample=bits, photometric="minisblack")
    assert np.array_equal(tifffile.imread("a.tif"), stored)
    read = cv2.imread("a.tif", cv2.IMREAD_UNCHANGED)
    seen[bits] = sorted(set((read[stored > 0] / stored[stored > 0]).tolist()))
    print(f"{bits} bits: {read.dtype}, read / stored = {seen[bits]}")
assert seen == {10: [64.0], 12: [16.0], 14: [4.0]}, "the behaviour has changed"
PY
