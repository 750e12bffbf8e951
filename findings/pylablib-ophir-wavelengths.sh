#!/usr/bin/env bash
# A good guess: pylablib's set_wavelength(980e-9) tells an Ophir Vega power meter that the light has 980 nm. Found: it tells 979: metres times 1e9 are
# cut to whole nanometres, and 980e-9 * 1e9 is 979.9999999999999. 28 of the wavelengths from 200 to 1100 nm, such as 245, 490 and 980, come a nanometre
# lower. And where a preset before the current one is empty, the current one is told as the next: 980 nm, the third, as 532.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps pylablib==1.4.5 pyserial==3.5 numpy==2.4.6 scipy==1.17.1 pandas==3.1.1 python-dateutil==2.9.0.post0 six==1.17.0
v/bin/python - <<'PY'
import os
import pty
import threading
import tty
from importlib.metadata import version

from pylablib.devices import Ophir

sent = []


def play(port):
    waiting = b""
    while True:
        waiting += os.read(port, 1000)
        *lines, waiting = waiting.split(b"\n")
        for line in lines:
            sent.append(line.decode().strip())
            presets = "CONTINUOUS 200 1100 3 633 NONE 980 532 NONE NONE" if sent[-1] == "$AW" else ""
            os.write(port, b"*" + presets.encode() + b"\r\n")


device, computer = pty.openpty()
tty.setraw(device), tty.setraw(computer)
threading.Thread(target=play, args=(device,), daemon=True).start()
meter = Ophir.VegaPowerMeter((os.ttyname(computer), 9600))
current = meter.get_wavelength()
told = {}
for nanometres in range(200, 1101):
    meter.set_wavelength(float(f"{nanometres}e-9"))
    told[nanometres] = int(next(line for line in reversed(sent) if line.startswith("$WL"))[3:])
lower = [asked for asked in told if told[asked] == asked - 1]
print("pylablib", version("pylablib"), "980e-9 is sent as", told[980], "; one lower from 200 to 1100 nm:", lower)
print("the third preset, 980 nm, is told as", current)
assert all(told[asked] == asked for asked in told if asked not in lower)
assert {245, 490, 980} <= set(lower) and len(lower) == 28, "the behaviour has changed"
assert round(current * 1e9) == 532, "presets: the behaviour has changed"
PY
