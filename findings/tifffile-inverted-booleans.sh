#!/usr/bin/env bash
# A good guess: tifffile writes a boolean array so that True is white, as Pillow does.
# Found: True becomes 1 in a file whose tag says that 0 is white. tifffile reads the numbers back as they are, without
# the tag; Pillow, OpenCV and imageio by Pillow show each mask inverted. photometric="minisblack" avoids it. Nothing
# warns, and an inverted mask of half its elements looks right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder"/venv/bin/pip install --quiet tifffile==2026.3.3 pillow==13.0.0 opencv-python-headless==5.0.0.93 imageio==2.38.1 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PY'
import sys

import cv2
import imageio.v3 as iio
import numpy as np
import PIL
import tifffile
from PIL import Image

print("tifffile", tifffile.__version__, "pillow", PIL.__version__, "opencv", cv2.__version__, "imageio", iio.__name__)
mask = np.zeros((6, 8), bool)
mask[:2] = True
seen = {}
for name, options in {"by default": {}, "minisblack": {"photometric": "minisblack"}}.items():
    tifffile.imwrite("mask.tif", mask, **options)
    with tifffile.TiffFile("mask.tif") as file:
        tag = file.pages[0].photometric.name
    read = {
        "tifffile": tifffile.imread("mask.tif"),
        "pillow": np.asarray(Image.open("mask.tif")),
        "opencv": cv2.imread("mask.tif", cv2.IMREAD_UNCHANGED),
        "imageio by pillow": iio.imread("mask.tif", plugin="pillow"),
    }
    seen[name] = {reader: "as written" if np.array_equal(values > 0, mask) else "inverted" for reader, values in read.items()}
    print(f"{name} ({tag}):", seen[name])
Image.fromarray(mask).save("mask.tif")
with tifffile.TiffFile("mask.tif") as file:
    print("pillow writes", file.pages[0].photometric.name)
default = seen["by default"]
if default.pop("tifffile") != "as written" or set(default.values()) != {"inverted"}:
    sys.exit("the behaviour has changed")
if set(seen["minisblack"].values()) != {"as written"}:
    sys.exit("the behaviour has changed")
PY
