#!/usr/bin/env bash
# A good guess: expelliarmus writes EVT3 files (event cameras of Prophesee) as their format says: words of 16 bits, of which type 8 holds
# bits 12 to 23 of the time and type 6 the lower 12, so that 5 seconds stay 5 seconds. Found: the upper bits are written once, at the begin:
# times in the file are modulo 4.096 ms for every other reader. Its own reader takes each fall for one turn, which hides it, but a pause of more
# than one turn is shortened there, too: 70 ms become 4.5 ms. EVT2 files of the same events are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check expelliarmus==1.1.12 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version
from pathlib import Path

import numpy as np
from expelliarmus import Wizard

times_us = np.array([0, 10, 5000, 5001, 70000, 70001])
events = np.zeros(len(times_us), dtype=[("t", "<i8"), ("x", "<i2"), ("y", "<i2"), ("p", "u1")])
events["t"], events["x"] = times_us, np.arange(len(times_us))

Wizard(encoding="evt2").save("evt2.raw", events)
Wizard(encoding="evt3").save("evt3.raw", events)
content = Path("evt3.raw").read_bytes()
while content.startswith(b"%"):
    content = content.split(b"\n", 1)[1]
upper = lower = 0
by_the_format = []
for word in np.frombuffer(content, "<u2").tolist():
    kind, value = word >> 12, word & 0xFFF
    if kind == 0x8:
        upper = value
    elif kind == 0x6:
        lower = value
    elif kind == 0x2:
        by_the_format.append(upper << 12 | lower)
own = Wizard(encoding="evt3").read("evt3.raw")["t"].tolist()
print("expelliarmus", version("expelliarmus"), "times, us:", times_us.tolist())
print("EVT3 read by its format:", by_the_format)
print("EVT3 read by expelliarmus:", own)
assert Wizard(encoding="evt2").read("evt2.raw")["t"].tolist() == times_us.tolist()
assert by_the_format == (times_us % 4096).tolist() and own[-1] == 4465, "the behaviour has changed"
PY
