#!/usr/bin/env bash
# A good guess: pygcode, which parses a line of G-code and writes it again, writes the numbers that were there, or as many digits as a stage
# resolves. Found: three digits after the point and six in all. A move of 0.4 µm becomes one of none, 0.5 µm becomes 1 µm, and far from the
# origin less is kept: X100000.5 becomes X100000. In inches (G20) three digits are 25 µm. From a million on the number gets an exponent,
# which a controller reads as a word E. And a sign of plus, which G-code allows, is refused.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pygcode==0.2.1
v/bin/python - <<'PY'
from importlib.metadata import version

from pygcode import GCodeLinearMove, Line
from pygcode.exceptions import GCodeWordStrError

written = {
    "G1 X-0.0004": "G01 X-0",
    "G1 X0.0005": "G01 X0.001",
    "G20 G1 X0.12345": "G20 G01 X0.123",
    "G1 X1234.5678": "G01 X1234.57",
    "G1 X100000.5": "G01 X100000",
    "G1 X1 F1234567": "F1.23457e+06 G01 X1",
}
for line, expected in written.items():
    again = str(Line(line))
    print("pygcode", version("pygcode"), f"{line!r} is written as {again!r}")
    assert sorted(again.split()) == sorted(expected.split()), "the behaviour has changed"
assert str(GCodeLinearMove(X=1 / 3)) == "G01 X0.333", "the behaviour has changed"
try:
    Line("G1 X+5")
except GCodeWordStrError as error:
    print("'G1 X+5':", error)
else:
    raise AssertionError("the behaviour has changed")
PY
