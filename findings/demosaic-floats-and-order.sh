#!/usr/bin/env bash
# A good guess: demosaic's own methods give what its method "cv" gives for the same code, and floats of 0 to 1 as they are. Found: a mosaic that begins
# with red, by RGGB2RGB, comes back blue, green, red from "none", "bilinear" and "malvar" and red, green, blue from "cv". "malvar", which is used if
# none is named, rounds: of 0.78, 0.39 and 0.2 it makes 1, 0 and 0. "none" gives every fourth pixel of floats no green. Pictures lose one, two or four rows
# and columns by the method, and are blurred unless blur_kernel is 0.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check demosaic==1.1.3 opencv-python-headless==5.0.0.93 numpy==2.4.6
OMP_NUM_THREADS=1 v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
from demosaic import bayer, colour

mosaic = np.tile(np.array([[200, 100], [100, 50]], np.uint16), (8, 8))
found = {}
for method in ("cv", "none", "bilinear", "malvar"):
    picture = bayer.demosaic(mosaic, method=method, colour=colour.RGGB2RGB, blur_kernel=0)
    found[method] = picture[6, 6].tolist(), picture.shape[:2]
    print("demosaic", version("demosaic"), f"{method}: a mosaic of red 200, green 100, blue 50 of 16 x 16 is", *found[method])
    if method != "cv":
        floats = bayer.demosaic(mosaic / 256, method=method, colour=colour.RGGB2RGB, blur_kernel=0)
        found[method, "floats"] = [np.unique(floats[..., channel].round(3)).tolist() for channel in range(3)]
        print("of floats of 0.781, 0.391 and 0.195 its channels are", found[method, "floats"])
point = np.zeros((16, 16), np.uint16)
point[8, 8] = 1000
spread = [int((bayer.demosaic(point, method="none", colour=colour.RGGB2RGB, **kind)[..., 2] > 0).sum()) for kind in ({"blur_kernel": 0}, {})]
print("one red pixel by none fills", spread[0], "pixels, without naming a blur", spread[1])
assert found["cv"] == ([200, 100, 50], (16, 16)) and found["bilinear", "floats"] == [[0.195], [0.391], [0.781]]
assert [found[each] for each in ("none", "bilinear", "malvar")] == [([50, 100, 200], (lines, lines)) for lines in (15, 14, 12)], "order: the behaviour has changed"
assert found["malvar", "floats"] == [[0], [0], [1]], "malvar: the behaviour has changed"
assert found["none", "floats"] == [[0.195], [0, 0.391], [0.781]], "none: the behaviour has changed"
assert spread[1] > spread[0], "blur: the behaviour has changed"
PY
