#!/usr/bin/env bash
# A good guess: PyMeasure's driver of Heidenhain's position display ND287, opened with units="inch" as its page offers, reads inches: the display's
# +0123456 is 1.23456 inches. Found: the argument is kept and the scale is not: positions come with the one for millimetres, ten times
# as large, 12.3456, while `units` says "inch". Set once more afterwards, units = "inch" makes them right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check --no-deps pymeasure==0.16.0 numpy==2.4.6 pyvisa==1.16.2 pyserial==3.5
v/bin/pip install --quiet --disable-pip-version-check --no-deps pint==0.25.3 flexparser==0.4 flexcache==0.3 platformdirs==4.14.9 typing_extensions==4.16.0
v/bin/python - <<'PY'
from importlib.metadata import version

from pymeasure.adapters import ProtocolAdapter
from pymeasure.instruments.heidenhain import ND287

answered = (b"\x1bA0200", b"\x02+0123456")
display = ND287(ProtocolAdapter([answered, answered]), units="inch")
before, said = display.position, display.units
display.units = "inch"
after = display.position
print("pymeasure", version("pymeasure"), f"opened in units {said!r} reads 1.23456 inches as {before:.4f}; told so again: {after:.5f}")
assert said == "inch" and round(before, 6) == 12.3456 and round(after, 6) == 1.23456, "the behaviour has changed"
PY
