#!/usr/bin/env bash
# A good guess: flirpy finds the same temperatures in a FLIR camera's readings as flirimageextractor, whose formula of what the air takes away it shares.
# Found: flirpy's raw2temp() divides the humidity by 100 only if it is above 100 per cent, so that "50.0 %", as ExifTool gives it and flirpy
# reads it, is 50 times saturated air: from 5 m on a scene at -3.9 degrees is at -11, and from 20 m at -42 or NaN. Zero distance hides it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps flirpy==0.6.2 flirimageextractor==1.5.11 numpy==2.4.6
v/bin/python -W ignore - <<'PY'
import ast
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from flirpy.util.raw import raw2temp

# flirimageextractor's one function: the rest of its file wants OpenCV and Matplotlib
tree = ast.parse(Path(find_spec("flirimageextractor").submodule_search_locations[0], "utils.py").read_text())
names = {"np": np}
parts = [part for part in tree.body if getattr(part, "name", "") == "sensor_vals_to_temp"]
exec(compile(ast.Module(parts, []), "utils.py", "exec"), names)

CAMERA = {"Planck R1": 21106.77, "Planck R2": 0.012545258, "Planck O": -7340, "Planck B": 1501, "Planck F": 1}
AIR = {"Alpha 1": 0.006569, "Alpha 2": 0.01262, "Beta 1": -0.002276, "Beta 2": -0.00667, "X": 1.9}
readings = np.array([12000.0, 14000.0, 18000.0])
found, right = {}, {}
for metres in (0, 1, 5, 20):
    told = CAMERA | {f"Atmospheric Trans {name}": value for name, value in AIR.items()}
    told |= {"Emissivity": 0.95, "IR Window Transmission": 1.0, "IR Window Temperature": "20.0 C", "Object Distance": f"{metres:.2f} m"}
    told |= {"Atmospheric Temperature": "20.0 C", "Reflected Apparent Temperature": "20.0 C", "Relative Humidity": "50.0 %"}
    found[metres] = raw2temp(readings, told)
    right[metres] = names["sensor_vals_to_temp"](readings, Emissivity=0.95, ObjectDistance=metres, RelativeHumidity=50)
    share = raw2temp(readings, told | {"Relative Humidity": "0.5"})
    assert np.allclose(share, right[metres], atol=0.01), "of a share of 1 they agree: the behaviour has changed"
    print("flirpy", version("flirpy"), f"{metres} m:", found[metres].round(1), "flirimageextractor", version("flirimageextractor"), right[metres].round(1))
assert np.allclose(found[0], right[0], atol=0.01)
assert np.allclose(found[5], [-38.18, -11.00, 24.03], atol=0.01) and np.allclose(right[5], [-22.19, -3.88, 23.25], atol=0.01), "the behaviour has changed"
assert np.isnan(found[20][0]) and np.allclose(found[20][1:], [-41.74, 26.50], atol=0.01), "the behaviour has changed"
PY
