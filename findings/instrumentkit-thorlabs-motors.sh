#!/usr/bin/env bash
# A good guess: InstrumentKit moves a Thorlabs stage MTS50-Z8 at a KDC101 by 10 mm if told so: 34,304 counts a millimetre, as its table of motors
# says, are 343,040. Found: the table's entry is inverted (a count in 34,304 mm): every move of the whole stage is to count 0, its home,
# without a word; the rotation stage in the same table is right. And no position can be read: of the answer only the six bytes of its
# header are, and its data, left in the port, would be the next answer. Seen at a controller that an object in the port's place plays.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --disable-pip-version-check --no-deps instrumentkit==0.6.0 numpy==1.23.5 quantities==0.13.0 future==1.0.0
v/bin/pip install --quiet --disable-pip-version-check --no-deps pyvisa==1.14.1 typing_extensions==4.12.2 pyserial==3.5
v/bin/pip install --quiet --disable-pip-version-check --no-deps python-vxi11==0.9 python-usbtmc==0.8 pyusb==1.2.1 ruamel.yaml==0.17.40
v/bin/python - <<'PY'
import struct
from importlib.metadata import version

import quantities as pq
from instruments.abstract_instruments.comm import LoopbackCommunicator
from instruments.thorlabs import APTMotorController


class Controller:
    """Answers as a KDC101 does: its description, the end of a move, its position; keeps the counts of absolute moves."""

    def __init__(self):
        self.moves, self.waiting = [], b""

    def write(self, message):
        kind = struct.unpack("<H", message[:2])[0]
        if kind == 0x0005:
            described = struct.pack("<l8sH4s48s12sHHH", 27000001, b"KDC101", 44, bytes(4), b"", b"", 1, 0, 1)
            self.waiting += struct.pack("<HHBB", 0x0006, len(described), 0x81, 0x50) + described
        elif kind == 0x0453:
            self.moves.append(struct.unpack("<l", message[8:12])[0])
            self.waiting += struct.pack("<HBBBB", 0x0464, 1, 0, 0x01, 0x50)
        elif kind == 0x0411:
            self.waiting += struct.pack("<HHBBHl", 0x0412, 6, 0x81, 0x50, 1, 34304)

    def read(self, size):
        taken, self.waiting = self.waiting[:size], self.waiting[size:]
        return taken


port = Controller()
channel = APTMotorController(LoopbackCommunicator(stdin=port, stdout=port)).channel[0]
channel.motor_model = "MTS50-Z8"
for millimetres in (10, 50):
    channel.move(pq.Quantity(millimetres, "mm"))
channel.motor_model = "PRM1-Z8"
channel.move(pq.Quantity(90, "deg"))
print("instrumentkit", version("instrumentkit"), "moves to 10 and 50 mm and, of a rotation stage, 90 degrees, in counts:", port.moves)
assert port.moves == [0, 0, 172767], "moves: the behaviour has changed"

try:
    position = channel.position
except struct.error as error:
    position = str(error)
print("position:", position, "bytes of it left in the port:", len(port.waiting))
assert position == "unpack requires a buffer of 6 bytes" and len(port.waiting) == 6, "positions: the behaviour has changed"
PY
