#!/usr/bin/env bash
# A good guess: where a Thorlabs motor is can be read as finely as its encoder counts, 34304 to a millimetre or 1920 to a degree. Found: by the
# recipe on thorlabs-apt-device's page, to_mm is made of the function that makes counts, which gives whole numbers: 12.34 mm are read
# as 12, 0.9 mm as 0, and a speed of 2.3 mm/s as 1150; its own to_pos and to_vel are right. pyKDC101 rounds to tenths of a degree what it
# reads: 0.0396 degrees are 0.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --disable-pip-version-check --no-deps thorlabs-apt-device==0.3.8 pykdc101==0.26 pyserial==3.5
v/bin/python - <<'PY'
import functools
import re
from importlib.metadata import version
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path

from pyKDC101 import KDC

COUNTS, TICK = 34304, 2048 / 6e6  # of an MTS50-Z8 stage at a TDC001, as the page has them
spec = spec_from_file_location("utils", Path(find_spec("thorlabs_apt_device").submodule_search_locations[0], "utils.py"))
utils = module_from_spec(spec)
spec.loader.exec_module(utils)
names = {**vars(utils), "partial": functools.partial}
recipe = {name: eval(made, names) for name, made in re.findall(r"^ +(\w+) = (partial\(.*\))$", utils.__doc__, re.MULTILINE)}
read = {mm: recipe["to_mm"](recipe["from_mm"](mm)) for mm in (12.34, 0.9, -3.7)}
counts_per_tick = recipe["from_mmps"](2.3)
speed, true_speed = recipe["to_mmps"](counts_per_tick), utils.to_vel(counts_per_tick, COUNTS, TICK)
print("thorlabs-apt-device", version("thorlabs-apt-device"), "mm read by its page:", read, "2.3 mm/s:", speed, "by to_vel:", round(true_speed, 4))
motor = KDC()
degrees = {}
for counts in (76, 500, 1920):
    degrees[round(counts / motor.PRM1_EncCnt, 4)] = motor.convert_enccnt(counts.to_bytes(4, "little").hex(" "))
print("pyKDC101", version("pykdc101"), "degrees read:", degrees)
assert read == {12.34: 12, 0.9: 0, -3.7: -3} and speed == 1150, "the recipe: the behaviour has changed"
assert abs(utils.to_pos(recipe["from_mm"](12.34), COUNTS) - 12.34) < 1e-4 and abs(true_speed - 2.3) < 1e-4, "the behaviour has changed"
assert list(degrees.items()) == [(0.0396, 0.0), (0.2605, 0.3), (1.0002, 1.0)], "degrees: the behaviour has changed"
PY
