#!/usr/bin/env bash
# A good guess: with pytmcstepper's motion control by a TMC2209's own clock (VACTUAL) run_to_position_steps() turns the motor by the steps asked for, and
# then stops it. Found: it rounds the way to whole turns. 0.6 and 1.4 turns are one, and 2.5 are two; of 0.4 turns zero are left, for which it
# starts the motor and does not stop it. `current_pos` says in each case that the way is done. And the speed is the one asked for
# divided by the microsteps of a step.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pytmcstepper==0.21.3 pyserial==3.5 Mock.GPIO==0.2.0
v/bin/python - <<'PY'
import os
import pty
import threading
import time
import tty
from importlib.metadata import version

from tmc_driver.com import TmcComUart
from tmc_driver.motion_control import MovementAbsRel, TmcMotionControlVActual
from tmc_driver.tmc_2209 import Tmc2209
from tmc_driver.tmc_logger import Loglevel

IFCNT, VACTUAL, CHOPCONF = 0x02, 0x22, 0x6C
device, name = pty.openpty()
tty.setraw(device)
registers = {CHOPCONF: 0x14000053}  # 16 microsteps a step
speeds = []  # moments at which the speed was written, and microsteps a second by the chip's clock of 12 MHz


def checksum(message):
    rest = 0
    for byte in message:
        for bit in range(8):
            rest = (rest << 1 ^ 7 * ((rest >> 7) ^ (byte >> bit & 1))) & 255
    return rest


def play():
    """Answer as a TMC2209 on one wire, on which each request is heard as well: four bytes read, eight write."""
    waiting = b""
    while True:
        waiting += os.read(device, 64)
        while len(waiting) >= 4 and len(waiting) >= (8 if waiting[2] & 128 else 4):
            length = 8 if waiting[2] & 128 else 4
            request, waiting = waiting[:length], waiting[length:]
            number = request[2] & 127
            if length == 8:
                registers[number] = int.from_bytes(request[3:7], "big", signed=True)
                registers[IFCNT] = (registers.get(IFCNT, 0) + 1) % 256
                if number == VACTUAL:
                    speeds.append((time.monotonic(), registers[number] * 12e6 / 2**24))
            else:
                answer = b"\x05\xff" + request[2:3] + registers.get(number, 0).to_bytes(4, "big", signed=True)
                os.write(device, request + answer + bytes([checksum(answer)]))


threading.Thread(target=play, daemon=True).start()
motor = Tmc2209(None, TmcMotionControlVActual(), TmcComUart(os.ttyname(name), 115200), loglevel=Loglevel.NONE)
motor.max_speed_fullstep = 200 * 32  # two turns a second once divided by 16
print("pytmcstepper", version("pytmcstepper"), "microsteps", motor.mres, "and of a turn", motor.steps_per_rev)
turned, still = {}, {}
for asked in (0.6, 1.4, 2.5, 0.4):
    speeds.clear()
    before = motor.current_pos
    motor.run_to_position_steps(round(asked * motor.steps_per_rev), MovementAbsRel.RELATIVE)
    time.sleep(0.2)
    moments = [moment for moment, _ in speeds[1:]] + [time.monotonic()]
    turned[asked] = sum(speed * (end - start) for (start, speed), end in zip(speeds, moments, strict=True)) / motor.steps_per_rev
    still[asked] = speeds[-1][1] == 0
    fastest = max(speed for _, speed in speeds) / motor.steps_per_rev
    said = (motor.current_pos - before) / motor.steps_per_rev
    print(f"asked for {asked} turns: turned {turned[asked]:.2f} at {fastest:.1f} a second, stopped: {still[asked]}, position says {said:.2f}")
    assert abs(said - asked) < 0.01 and abs(fastest - 2) < 0.1, "the behaviour has changed"
motor.tmc_mc.set_vactual(0)
for asked, whole in ((0.6, 1), (1.4, 1), (2.5, 2)):
    assert abs(turned[asked] - whole) < 0.3 and still[asked], "turns: the behaviour has changed"
assert not still[0.4], "a part of a turn: the behaviour has changed"
PY
