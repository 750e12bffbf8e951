#!/usr/bin/env bash
# A good guess: mksact, which drives MKS servo motors by CAN, turns a motor by as many turns as it is told, or refuses what the
# drive's coordinate of 24 bits cannot hold, as it refuses what is beyond its limits. Found: it cuts to 24 bits: 600 turns, 600 mm of a spindle
# of 1 mm, are sent as -424, the other way, and pass limits of 0 to 700 turns. From 500 turns on, one of 50 more goes back by 974.
# The motor is a stand-in on python-can's virtual bus, after the command F5 that the library cites from the manual.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps mksact==0.2.0 python-can==4.6.1 wrapt==1.17.3 packaging==26.4 typing_extensions==4.15.0
v/bin/python - <<'PY'
import threading
from importlib.metadata import version

import can
from mksact import Actuator

TURN, ADDRESS = 16384, 1
position, done = [0], threading.Event()


def motor(bus):
    """Answer as the motor does: its position in 48 bits, moves to a coordinate in 24, all else by a 1."""
    while not done.is_set():
        message = bus.recv(timeout=0.05)
        if message is None:
            continue
        code, data = message.data[0], bytes(message.data)
        if code == 0x31:
            answers = [position[0].to_bytes(6, "big", signed=True)]
        elif code == 0xF5:
            position[0] = int.from_bytes(data[4:7], "big", signed=True)
            answers = [b"\1", b"\2"]
        elif code == 0x92:
            position[0] = 0
            answers = [b"\1"]
        else:
            answers = [b"\1"]
        for answer in answers:
            body = bytes([code]) + answer
            bus.send(can.Message(arbitration_id=ADDRESS, data=body + bytes([(ADDRESS + sum(body)) & 255]), is_extended_id=False))


with can.Bus(interface="virtual", channel="line") as line:
    thread = threading.Thread(target=motor, args=(line,))
    thread.start()
    actuator = Actuator(channel="line", can_id=ADDRESS, interface="virtual", verbose=False).connect()
    found = {}
    for turns in (400, 511, 600):
        position[0] = 0
        actuator.set_zero()
        actuator.set_limits(0, 700 * TURN)
        actuator.move_turns(turns, wait=True, timeout=5)
        found[turns] = position[0] / TURN
    position[0] = 500 * TURN
    actuator.move_turns(50, wait=True, timeout=5)
    further = position[0] / TURN - 500
    refused = False
    try:
        actuator.move_abs(701 * TURN)
    except ValueError as error:
        refused = True
        print("refused:", error)
    actuator.close()
    done.set()
    thread.join()
print("mksact", version("mksact"), "turns asked for and made:", found, "; 50 more from 500 on:", further)
assert refused and found[400] == 400 and found[511] == 511
assert found[600] == -424 and further == -974, "the behaviour has changed"
PY
