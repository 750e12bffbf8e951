#!/usr/bin/env bash
# A good guess: in OpenWFS (a @ b) @ point is a @ (b @ point) for all its transforms; and place(), which scales pictures "using area interpolation",
# gives a larger pixel the mean of the smaller ones that it covers. Found: a composed transform has lost the second's source_origin if
# the first has no destination_origin: a turn of 90 degrees about (1, 2) um is off by (2, 1) um. place() takes the nearest pixel, an upper left one:
# of four pixels three are lost, a bright spot with them, and all else moves by half a small pixel.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check nidaqmx==1.7.0 pyserial==3.5 PyOpenGL==3.1.10 glfw==2.11.0 astropy==8.0.2 scipy==1.17.1 numpy==2.4.6 matplotlib==3.11.2 opencv-python-headless==5.0.0.93 annotated-types==0.8.0
v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps openwfs==1.1.0
OMP_NUM_THREADS=1 MPLBACKEND=agg v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import astropy.units as u
import numpy as np
from openwfs.utilities import Transform, place, set_pixel_size

point = (3.0, 4.0) * u.um
turn = [[0.0, -1], [1, 0]]
second = {"about (1, 2) um": Transform(turn, source_origin=(1, 2) * u.um), "about the middle": Transform(turn)}
first = {"without destination_origin": Transform(), "with one": Transform(destination_origin=(5, 7) * u.um)}
off = {}
for name, b in first.items():
    for about, a in second.items():
        apart, composed = a @ (b @ point), (a @ b) @ point
        off[name, about] = abs((composed - apart).to_value(u.um)).tolist()
        print("openwfs", version("openwfs"), f"a turn {about} after one {name}: {apart}, composed {composed}")
spot = np.zeros((8, 8), np.float32)
spot[2, 3] = 16
ramp = np.tile(np.arange(8, dtype=np.float32), (8, 1))
halved = [np.array(place((4, 4), np.full(2, 2.0) * u.um, set_pixel_size(each, 1 * u.um))) for each in (spot, ramp)]
print("a spot of 16, a pixel of four:", halved[0].max(), "; columns 0 to 7 become", halved[1][0].tolist())
assert off["with one", "about (1, 2) um"] == off["with one", "about the middle"] == off["without destination_origin", "about the middle"] == [0, 0]
assert off["without destination_origin", "about (1, 2) um"] != [0, 0], "compose: the behaviour has changed"
assert halved[0].max() == 0, "place: the behaviour has changed"
assert halved[1][0].tolist() == [0, 2, 4, 6], "place: the behaviour has changed"
PY
