#!/usr/bin/env bash
# A good guess: FabIO reads from a detector's frame in Bruker's newer format (FORMAT 100) what it wrote there. Found: frames in double precision are
# stretched to 24 bits, the scale is noted in the header (LINEAR, as Bruker's page of the format asks), and the reader never looks at it: a
# frame of up to 20000 comes back 839 times as bright. The same frame in single precision keeps its values, cut to integers, so that a
# frame from 0 to 1 is 0, without a word. (Its reader of the older format, 86, does apply LINEAR.)
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check fabio==2026.6.0 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import fabio
import numpy as np
from fabio.bruker100image import Bruker100Image

ratios = {}
for name, kind, brightest in (("double", np.float64, 20000), ("single", np.float32, 20000), ("single, 0 to 1", np.float32, 0.999)):
    frame = np.linspace(0, brightest, 16).reshape(4, 4).astype(kind)
    Bruker100Image(data=frame).write("frame.sfrm")
    again = fabio.open("frame.sfrm")
    ratios[name] = float(again.data.max() / frame.max())
    print("fabio", version("fabio"), name, "LINEAR", again.header.get("LINEAR"), "read", again.data.dtype, "brightness x", round(ratios[name], 2))
assert 838 < ratios["double"] < 840, "the behaviour has changed: frames in double precision"
assert ratios["single"] == 1 and ratios["single, 0 to 1"] == 0, "the behaviour has changed: frames in single precision"
PY
