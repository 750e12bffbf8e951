#!/usr/bin/env bash
# A good guess: set_velocity(1) and set_acceleration(1) of QMI's driver of Thorlabs' KDC101, with an actuator Z925 and with a rotation stage PRMTZ8, send
# what its own comment says, counts a unit x T x 65536 x velocity, and with T squared for accelerations. Found: the factors beside the comment hold
# T x 65536 already and are multiplied by it once more: 22 times the velocity and acceleration are sent for each, past the actuator's 2.6 mm/s,
# which the driver checks before; and a stage that runs at 2 mm/s is read as 0.089. Positions are right. Seen in the messages that are sent.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check qmi==0.54.2 numpy==2.4.6 scipy==1.17.1
v/bin/python - <<'PY'
import os
import pty
import struct
import threading
import tty
from importlib.metadata import version

from qmi.core.context import QMI_Context
from qmi.instruments.thorlabs.kdc101 import Thorlabs_Kdc101

T = 2048 / 6e6


def controller(line, state):
    """Answers requests for velocities, and keeps what is set: least and largest velocity, acceleration."""
    while True:
        head = os.read(line, 6)
        kind, size = struct.unpack("<HH", head[:4])
        data = os.read(line, size) if head[4] & 0x80 else b""
        if kind == 0x0413:
            state.update(zip(("acceleration", "velocity"), struct.unpack("<ii", data[6:14])))
        elif kind == 0x0005:
            os.write(line, struct.pack("<HHBBI8sHI60xHHH", 0x0006, 84, 0x81, 0x50, 27000001, b"KDC101", 16, 1, 1, 1, 1))
        elif kind == 0x0414:
            os.write(line, struct.pack("<HHBBHiii", 0x0415, 14, 0x81, 0x50, 1, 0, state["acceleration"], state["velocity"]))


found = {}
for actuator, counts in (("Z925", 512 * 67.49), ("PRMTZ8", 1919.6418578623391)):
    velocity, acceleration = counts * T * 65536, counts * T * T * 65536
    state = {"velocity": round(2 * velocity), "acceleration": round(acceleration)}
    device, computer = pty.openpty()
    tty.setraw(device), tty.setraw(computer)
    threading.Thread(target=controller, args=(device, state), daemon=True).start()
    stage = Thorlabs_Kdc101(QMI_Context("bench"), actuator, f"serial:{os.ttyname(computer)}:rtscts=False", actuator)
    stage.open()
    read = stage.get_velocity()
    stage.set_velocity(1.0)
    stage.set_acceleration(1.0)
    stage.get_velocity()  # an answer comes after what was sent before is kept
    found[actuator] = state["velocity"] / velocity, state["acceleration"] / acceleration, read
    print("QMI", version("qmi"), actuator, "1 a second is sent as", round(found[actuator][0], 2), "and 1 a second squared as", round(found[actuator][1], 2), "; 2 a second is read as", round(read, 4))
assert all(abs(factor - 22.37) < 0.05 for values in found.values() for factor in values[:2]), "the behaviour has changed"
assert all(abs(read - 2 / 22.37) < 0.001 for _, _, read in found.values())
PY
