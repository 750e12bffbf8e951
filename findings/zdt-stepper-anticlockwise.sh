#!/usr/bin/env bash
# A good guess: JogParams(direction=Direction.CCW, speed=100) of zdt-stepper jogs a ZDT motor anticlockwise, and PositionParams(direction=Direction.CCW,
# pulse_count=3200) moves it so. Found: both go clockwise. What is not below zero sets the direction to CW, whatever was given: also Speed(100) and
# PulseCount(3200), the library's own types, which are whole numbers, too, and cannot be below zero. Only a negative plain number, or setting
# `direction` afterwards, goes anticlockwise. Seen in the frames that are sent, F6 and FD, whose third byte is the direction.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps zdt-stepper==0.1.1 pyserial==3.5 pyyaml==6.0.4 tqdm==4.70.1
v/bin/python - <<'PY'
from importlib.metadata import version

from stepper.commands.move import Jog, Move
from stepper.stepper_core.configs import Direction, PulseCount, Speed
from stepper.stepper_core.parameters import DeviceParams, JogParams, PositionParams


class Line:
    """A stand-in for the serial line: it keeps what is sent, and answers each command as received."""

    is_open, name = True, "line"

    def __init__(self):
        self.sent, self.answer = [], b""

    def write(self, frame):
        self.sent.append(bytes(frame))
        self.answer = bytes([frame[0], frame[1], 0x02, 0x6B])
        return len(frame)

    def read(self, count=1):
        part, self.answer = self.answer[:count], self.answer[count:]
        return part

    def __getattr__(self, name):
        return lambda *values: None


line = Line()
device = DeviceParams(serial_connection=line, address=1)
afterwards = JogParams(speed=100)
afterwards.direction = Direction.CCW
cases = {
    "jog CCW, 100": (Jog, JogParams(direction=Direction.CCW, speed=100)),
    "jog CCW, Speed(100)": (Jog, JogParams(direction=Direction.CCW, speed=Speed(100))),
    "jog CCW, no speed": (Jog, JogParams(direction=Direction.CCW)),
    "move CCW, 3200": (Move, PositionParams(direction=Direction.CCW, pulse_count=3200)),
    "move CCW, PulseCount(3200)": (Move, PositionParams(direction=Direction.CCW, pulse_count=PulseCount(3200))),
    "jog -100": (Jog, JogParams(speed=-100)),
    "move -3200": (Move, PositionParams(pulse_count=-3200)),
    "jog 100, direction set to CCW": (Jog, afterwards),
}
found = {}
for name, (command, values) in cases.items():
    assert command(device, values).is_success
    found[name] = Direction(line.sent[-1][2]).name
    print("zdt-stepper", version("zdt-stepper"), f"{name}: sends {line.sent[-1].hex(' ')}, {found[name]}")
assert [found[name] for name in ("jog -100", "move -3200", "jog 100, direction set to CCW")] == ["CCW"] * 3
assert all(found[name] == "CW" for name in found if " CCW, " in name), "the behaviour has changed"
PY
