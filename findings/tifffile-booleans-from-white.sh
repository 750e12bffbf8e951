#!/usr/bin/env bash
# A good guess: masks that tifffile saves as a boolean array are read by Pillow and OpenCV as they are. Found: inverted. tifffile gives
# booleans the tag of pictures whose 0 is white (PhotometricInterpretation 0; arrays of bytes get 1), and does not look at it when it reads
# them, so that its own round trip is right; who follows the tag sees open elements closed. With photometric="minisblack" all agree.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --disable-pip-version-check tifffile==2026.3.3 pillow==13.0.0 opencv-python-headless==5.0.0.93 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import cv2
import numpy as np
import tifffile
from PIL import Image

mask = np.zeros((4, 8), dtype=bool)
mask[:, 0] = True


def read_back(**how):
    tifffile.imwrite("mask.tif", mask, **how)
    everybody = {
        "tifffile": tifffile.imread("mask.tif"),
        "Pillow": np.asarray(Image.open("mask.tif")),
        "OpenCV": cv2.imread("mask.tif", cv2.IMREAD_UNCHANGED),
    }
    return {name: "inverted" if ((read > 0) == ~mask).all() else "as written" if ((read > 0) == mask).all() else "otherwise"
            for name, read in everybody.items()}


plain, told = read_back(), read_back(photometric="minisblack")
print("tifffile", version("tifffile"), "Pillow", version("pillow"), "OpenCV", cv2.__version__, "by default", plain, "as minisblack", told)
assert plain == {"tifffile": "as written", "Pillow": "inverted", "OpenCV": "inverted"}, "the behaviour has changed"
assert set(told.values()) == {"as written"}, "what is told has changed: the behaviour has changed"
PY
