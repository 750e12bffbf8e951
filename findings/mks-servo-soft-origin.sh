#!/usr/bin/env bash
# A good guess: after set_origin(soft=True) of mks-servo, which makes the present place of an MKS servo motor the origin, read() is 0 and write(0)
# stays there. Found: read() is 0, and write(0) turns the motor as far to the other side of the drive's own zero: from 5 turns to -5. Reading
# takes the offset off, and so does writing, which should add it. Limits of position are checked before, in the new degrees, and let it pass;
# move_relative() adds to what was read, and goes astray as far. Without soft=True all is right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps mks-servo==1.0.0 pyserial==3.5 ruamel.yaml==0.19.1
v/bin/python - <<'PY'
from importlib.metadata import version

from mks_servo.motor import Motor
from mks_servo.profile import DriverSection, Profile

TURN = 16384  # counts of its encoder


class Drive:
    """A stand-in for the driver of the board's commands, which knows where the shaft is."""

    def __init__(self):
        self.counts = 0

    def read_encoder_addition(self):
        return self.counts

    def move_absolute_axis(self, counts, rpm, acc):
        self.counts = counts

    def move_relative_axis(self, counts, rpm, acc):
        self.counts += counts

    def set_zero_point(self):
        self.counts = 0

    def __getattr__(self, name):
        return lambda *values, **named: True


found = {}
for soft in (False, True):
    profile = Profile(id="stage", driver=DriverSection())
    profile.limits.position.min_deg, profile.limits.position.max_deg = -10.0, 2000.0
    drive = Drive()
    with Motor(profile, raw=drive) as motor:
        motor.write(5 * 360)
        before = drive.counts / TURN, motor.read()
        motor.set_origin(soft=soft)
        there, zero = motor.read(), drive.counts
        motor.write(0)
        found[soft] = (drive.counts - zero) / TURN, motor.read()
        drive.counts = zero
        motor.move_relative(90)
        relative = (drive.counts - zero) / TURN
    print("mks-servo", version("mks-servo"), f"soft={soft}: at {before} turns and degrees the origin is set, read() is {there}; write(0) then turns it by {found[soft][0]} turns, to {found[soft][1]} degrees of limits from -10 to 2000; a relative move by 90 degrees by {relative} turns")
    assert before == (5, 1800) and there == 0
    found[soft] += (relative,)
assert found[False] == (0, 0, 0.25)
assert found[True] == (-10, -3600, -9.75), "the behaviour has changed"
PY
