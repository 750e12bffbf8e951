#!/usr/bin/env bash
# A good guess: pylablib writes a sensor's curve into Lake Shore's thermometer 218 with the device's five digits after the point, and get_curve() gives
# back all of its points. Found: set_curve() sends millivolts, 1.62345 as 1.623, which is up to 0.3 kelvins of a silicon diode of 1.7 mV/K; and
# get_curve() gives all points but the last, the coldest: a curve that is read and written back is a point shorter each time.
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

from pylablib.devices import Lakeshore

points = {}


def answer(line):
    """The thermometer's answer to a line, or None. It keeps the points of one curve, volts and kelvins."""
    if line.startswith("*IDN?"):
        return "LSCI,MODEL218S,0,1"
    if line.startswith("CRVPT?"):
        return "{:+.5f},{:+.3f}".format(*points.get(int(line.split()[-1]), (0, 0)))
    command, asked, _ = line.partition(";*OPC?")
    if command.startswith("CRVPT "):
        _, index, volts, kelvins = command[6:].split(",")
        points[int(index)] = float(volts), float(kelvins)
    return "1" if asked else None


def play(port):
    waiting = b""
    while True:
        waiting += os.read(port, 1000)
        *lines, waiting = waiting.split(b"\n")
        for line in lines:
            reply = answer(line.decode().strip())
            if reply is not None:
                os.write(port, reply.encode() + b"\r\n")


device, computer = pty.openpty()
tty.setraw(device), tty.setraw(computer)
threading.Thread(target=play, args=(device,), daemon=True).start()
thermometer = Lakeshore.Lakeshore218((os.ttyname(computer), 9600, 8, "N", 1))
curve = [(0.51234, 300.0), (1.02345, 77.35), (1.62345, 4.2)]
read = thermometer.set_curve(21, curve)
kept = [points[index] for index in (1, 2, 3)]
print("pylablib", version("pylablib"), "curve", curve)
print("the thermometer has", kept, "and get_curve() gives", read.tolist())
assert kept == [(0.512, 300.0), (1.023, 77.35), (1.623, 4.2)], "digits: the behaviour has changed"
assert read.tolist() == [[0.512, 300.0], [1.023, 77.35]], "points: the behaviour has changed"
PY
