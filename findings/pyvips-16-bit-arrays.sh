#!/usr/bin/env bash
# A good guess: pyvips writes an array of 16-bit readings as a 16-bit PNG, as it does with a picture of 16 bits that it has read. Found: a grey array
# counts as "b-w", a picture of 8 bits, whatever its numbers: in the PNG all readings from 255 on are 255, without a word. TIFF keeps
# them, and so does PNG where interpretation="grey16" is said; an array in colour keeps them by itself, though it counts as "srgb".
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --disable-pip-version-check pyvips==3.2.0 pyvips-binary==8.18.7 opencv-python-headless==5.0.0.93 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import cv2
import numpy as np
import pyvips

grey, colour = np.full((6, 8), 8000, np.uint16), np.full((6, 8, 3), 8000, np.uint16)
found = {}
for name, array, file, said in (
    ("grey PNG", grey, "a.png", {}),
    ("grey TIFF", grey, "a.tif", {}),
    ("grey PNG, told", grey, "b.png", {"interpretation": "grey16"}),
    ("colour PNG", colour, "c.png", {}),
):
    image = pyvips.Image.new_from_array(array, **said)
    image.write_to_file(file)
    read = cv2.imread(file, cv2.IMREAD_UNCHANGED)
    found[name] = int(read.flat[0])
    print("pyvips", version("pyvips"), name, image.interpretation, "8000 becomes", found[name], read.dtype)
assert found == {"grey PNG": 255, "grey TIFF": 8000, "grey PNG, told": 8000, "colour PNG": 8000}, "the behaviour has changed"
PY
