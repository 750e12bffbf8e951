#!/usr/bin/env bash
# A good guess: pyspng reads a grey PNG of 16 bits as [height, width], as it says and does for 8 bits, and a coloured one as [height, width, 3].
# Found: in 16 bits every picture has an opacity, whether the file has or not: grey comes as [height, width, 2], colour as
# [height, width, 4], the last channel 65535 throughout. Means, maxima and norms of readings are those of both together.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pyspng==0.1.4 opencv-python-headless==5.0.0.93 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import cv2
import numpy as np
import pyspng

shapes = {}
for kind in (np.uint8, np.uint16):
    for channels in ((), (3,)):
        written = np.full((6, 8, *channels), 100, kind)
        cv2.imwrite("picture.png", written)
        with open("picture.png", "rb") as file:
            read = pyspng.load(file.read())
        shapes[np.dtype(kind).name, len(channels)] = read.shape
        print("pyspng", version("pyspng"), np.dtype(kind).name, written.shape, "comes as", read.dtype, read.shape, "of mean", read.mean())
assert shapes["uint8", 0] == (6, 8) and shapes["uint8", 1] == (6, 8, 3), "8 bits: the behaviour has changed"
assert shapes["uint16", 0] == (6, 8, 2) and shapes["uint16", 1] == (6, 8, 4), "16 bits: the behaviour has changed"
PY
