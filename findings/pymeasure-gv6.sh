#!/usr/bin/env bash
# A good guess: pymeasure's driver for Parker's GV6 servo controller reads where the motor is, and angle = 90 turns it by a quarter, for its page
# says degrees, and 4000 counts for a revolution. Found: nothing can be read, each is an AttributeError of a method that the
# library no longer has; and 90 degrees are 200000 counts, 50 revolutions: a gear of 1 to 200 is written into the class.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --disable-pip-version-check --no-deps pymeasure==0.16.0 pyvisa==1.16.2 pyserial==3.5 typing_extensions==4.16.0 numpy==2.4.6
v/bin/python -W ignore::FutureWarning - <<'PY'
from importlib.metadata import version

from pymeasure.adapters import FakeAdapter
from pymeasure.instruments.parker import ParkerGV6


class Line(FakeAdapter):
    """A serial line to a controller that answers that the motor is at 4000 counts."""

    sent = ()

    def _write(self, command, **_):
        self.sent = (*self.sent, command)

    def _read(self, **_):
        return "*TPE4000\r\n\n> "


line = Line()
motor = ParkerGV6(line)
begun = len(line.sent)
motor.angle = 90
turned = line.sent[begun:]
errors = {}
for name in ("position", "angle", "position_error", "status"):
    try:
        errors[name] = getattr(motor, name)
    except AttributeError as error:
        errors[name] = str(error)
page = [line.strip() for line in ParkerGV6.position.__doc__.splitlines() if "revolution" in line]
print("pymeasure", version("pymeasure"), "90 degrees are sent as", turned, "its page:", page)
print("what is read:", errors)
assert turned == ("D200000",), "turning: the behaviour has changed"
assert all("readlines" in str(error) for error in errors.values()), "reading: the behaviour has changed"
PY
