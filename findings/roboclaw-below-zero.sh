#!/usr/bin/env bash
# A good guess: the package roboclaw, which drives Basicmicro's RoboClaw motor controllers, reads the place that it drives to, and what each
# input pin is for. Found: drive_to_position() sends signed counts and read_encoder() takes them as unsigned: at -500 of a way from -1000 to
# 1000 a motor stands at 214 million per cent of it. And the pins S4 and S5 are told by S3's setting: an emergency stop is "Disabled".
# Two things wrong at once, which the controller tells as two bits, are an "Unknown Error". (pycrc, which it asks for, is not the PyCRC it imports.)
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps roboclaw==1.0.0.dev1 pyserial==3.5 pythoncrc==1.21
v/bin/python - <<'PY'
import struct
from importlib.metadata import version

import serial
from PyCRC.CRCCCITT import CRCCCITT
from roboclaw import RoboClaw


class Controller:
    """A RoboClaw by its manual: moves by command 65, counts by 16, limits by 63, pins by 75, errors by 90, each with a checksum."""

    def __init__(self, **_settings):
        self.counts, self.pins, self.errors, self.reply = 0, (0, 0, 0), 0, b""

    def write(self, sent):
        command, told = sent[1], b""
        if command == 65:
            self.counts = struct.unpack(">IiIiB", sent[2:-2])[3]
            self.reply = b"\xff"
            return
        if command == 16:
            told = struct.pack(">iB", self.counts, 0)
        elif command == 63:
            told = struct.pack(">IIIIIii", 1, 1, 1, 1, 1, -1000, 1000)
        elif command == 55:
            told = struct.pack(">IIII", 1, 1, 1, 2000)
        elif command == 75:
            told = bytes(self.pins)
        elif command == 90:
            told = bytes([self.errors])
        self.reply = told + struct.pack(">H", CRCCCITT().calculate(sent[:2] + told))

    def read(self, count):
        return self.reply[:count]

    def close(self):
        pass

    open = flush = close


serial.Serial = Controller
claw = RoboClaw("port", 0x80)
claw.drive_to_position(1, 100, 50, 100, 75, 1)
forwards = claw.port.counts, claw.read_encoder(1), claw.read_position(1)
claw.drive_to_position(1, 100, 50, 100, 25, 1)
backwards = claw.port.counts, claw.read_encoder(1), round(claw.read_position(1))
print("roboclaw", version("roboclaw"), "counts, counts read and per cent after driving to 75 %:", forwards, "and to 25 %:", backwards)
assert forwards == (500, 500, 75) and backwards == (-500, 4294966796, 214748390), "counts: the behaviour has changed"
claw.port.pins = (0, 2, 4)
pins = claw.read_input_pin_modes()
claw.port.errors = 1
one = claw.read_status()
claw.port.errors = 3
both = claw.read_status()
print("S4 stops in an emergency, S5 is a home switch:", pins, "errors of one motor and of both:", one, "and", both)
assert pins == ("Default", "Disabled", "Disabled"), "pins: the behaviour has changed"
assert one == "Warning: High Current - Motor 1" and both == "Unknown Error", "errors: the behaviour has changed"
PY
