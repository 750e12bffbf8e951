#!/usr/bin/env bash
# A good guess: tmcl, which talks to Trinamic's controllers of stepper motors, sends and reads positions of 32 bits with their sign, and the lowest
# byte of the sum as checksum (Trinamic's TMCL reference manual). Found: it reads -100 as 4294967196, cannot send a position below zero,
# and puts the whole sum into the checksum's byte, which holds no more than 255: positions above 249 microsteps are errors, too.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check tmcl==1.1.1
v/bin/python - <<'PY'
import struct
from importlib.metadata import version

import TMCL

GET_POSITION, ADDRESS = (6, 1), 1


class Line:
    """A serial line with a controller, which keeps its parameters by their numbers."""

    def __init__(self):
        self.kept, self.reply = {}, b""

    def write(self, telegram):
        address, command, number, _, value, checksum = struct.unpack(">BBBBiB", telegram)
        assert address == ADDRESS and checksum == sum(telegram[:8]) % 256
        if command == 5:
            self.kept[number] = value
        answer = struct.pack(">BBBBi", 2, address, 100, command, self.kept.get(number, 0))
        self.reply = answer + bytes([sum(answer) % 256])

    def read(self, count):
        return self.reply[:count]


line = Line()
motor = TMCL.connect(line).get_motor(ADDRESS)
line.kept[1] = -100
read = motor.axis.actual_position
print("tmcl", version("tmcl"), "reads -100 as", read)
went = {}
for position in (100, 249, 250, 51200, -100):
    try:
        motor.axis.target_position = position
        went[position] = line.kept[0]
    except struct.error as error:
        went[position] = str(error)
    print("asked for", position, "->", went[position])
assert read == 2**32 - 100, "reading: the behaviour has changed"
assert (went[100], went[249]) == (100, 249), "small positions: the behaviour has changed"
assert all(isinstance(went[position], str) for position in (250, 51200, -100)), "positions: the behaviour has changed"
PY
