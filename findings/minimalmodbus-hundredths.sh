#!/usr/bin/env bash
# A good guess: minimalmodbus's `write_register(0, 0.29, 2)` writes 29: its page says that two decimals multiply the value by 100 "before
# sending it". Found: what floating point leaves of the product is cut off, not rounded: 28 is written. So are 4,586 of the 65,536 values that a
# register of two decimals has, and 741 of three decimals, each lower by one; negative ones are one too high. None of one decimal.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check minimalmodbus==2.1.1 pyserial==3.5
v/bin/python - <<'PY'
import os
import pty
import threading
import tty
from importlib.metadata import version

import minimalmodbus
import serial

device, name = pty.openpty()
tty.setraw(device)
written = []


def answer():
    """Play a controller with registers: keep what is written (function 6) and answer with the same eight bytes."""
    while True:
        request = b""
        while len(request) < 8:
            request += os.read(device, 8 - len(request))
        written.append(int.from_bytes(request[4:6], "big", signed=True))
        os.write(device, request)


threading.Thread(target=answer, daemon=True).start()
port = serial.Serial(os.ttyname(name), 115200, timeout=10)
controller = minimalmodbus.Instrument(port, 1)
for value in (0.28, 0.29, 4.35, 25.5, -0.29):
    controller.write_register(0, value, 2, functioncode=6, signed=True)
print("minimalmodbus", version("minimalmodbus"), "writes 0.28, 0.29, 4.35, 25.5 and -0.29 with two decimals as", written)
assert written == [28, 28, 434, 2550, -28], "the behaviour has changed"

wrong = [
    sum(minimalmodbus._num_to_two_bytes(number / 10**digits, digits) != number.to_bytes(2, "big") for number in range(65536))
    for digits in (1, 2, 3)
]
print("numbers of 65536 that come out one lower, of one, two and three decimals:", wrong)
assert wrong == [0, 4586, 741], "the behaviour has changed"
PY
