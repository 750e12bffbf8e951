#!/usr/bin/env bash
# A good guess: odak's save_image(file, pattern, cmin, cmax) spreads cmin to cmax over the grey levels, as its documentation says ("minimum
# value that will be interpreted as 0 level"). Found: cmin only cuts, the values are divided by cmax alone, and cut to whole levels: 100 to 200
# becomes 127 to 255. A hologram's phase from -pi to pi, saved with these two, has negative levels before it becomes bytes; where these come
# round, as on x86, the picture shows twice the phase (0, pi/2, pi: 0, 127, 255), and a panel of 256 levels for one wave shows another hologram.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check odak==0.2.7 torch==2.14.1 numpy==2.4.6
v/bin/python - <<'PY' 2>&1 | grep -v INFO
from importlib.metadata import version

import numpy as np
from odak.tools import load_image, save_image


def levels(values, lowest, highest):
    save_image("pattern.png", np.repeat(values[None], 4, 0), cmin=lowest, cmax=highest)
    return load_image("pattern.png")[0].astype(int).tolist()


counts = levels(np.linspace(100, 200, 5), 100, 200)
print("odak", version("odak"), "100 to 200, saved as cmin=100, cmax=200:", counts)
phase = levels(np.linspace(-np.pi, np.pi, 5), -np.pi, np.pi)
print("phase of -pi, -pi/2, 0, pi/2, pi, saved as cmin=-pi, cmax=pi:", phase)
rounded = levels(np.array([0, 0.9, 1.0]), 0, 1)
print("0, 0.9 and 1 of 1:", rounded, "(229.5 is cut to 229)")
assert counts == [127, 159, 191, 223, 255] and phase[2:] == [0, 127, 255], "the behaviour has changed"
PY
