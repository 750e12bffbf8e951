#!/usr/bin/env bash
# A good guess: PyMeasure sends a stage or a laser the number that it is given: Newport's ESP300 to 123.4567 mm, Santec's TSL-570 to
# 1550.1234 nm. Found: these drivers, and others, write "%g", six digits in all: 123.457 mm and 1550.12 nm. Beyond
# 100 mm a stage goes by micrometres; from a million encoder counts on the number has an exponent. Others of its drivers write "%f" or
# "%.3f". Seen in what each driver sends to an adapter that keeps it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check --no-deps pymeasure==0.16.0 numpy==2.4.6 pyvisa==1.16.2 pyserial==3.5
v/bin/pip install --quiet --disable-pip-version-check --no-deps pint==0.25.3 flexparser==0.4 flexcache==0.3 platformdirs==4.14.9 typing_extensions==4.16.0
v/bin/python - <<'PY'
from importlib.metadata import version

from pymeasure.adapters import ProtocolAdapter
from pymeasure.instruments.newport import ESP300
from pymeasure.instruments.santec import TSL570


class Listener(ProtocolAdapter):
    """Keep what is sent and answer each question with no error."""

    def __init__(self):
        super().__init__()
        self.sent = []

    def _write(self, command, **_):
        self.sent.append(command.strip())

    def _read(self, **_):
        return '+0,"No error"'


def sent(instrument, value, *names):
    listener = Listener()
    *path, name = names
    target = instrument(listener)
    for part in path:
        target = getattr(target, part)
    before = len(listener.sent)
    setattr(target, name, value)
    return listener.sent[before]


stage = [sent(ESP300, value, "x", "position") for value in (123.456, 123.4567, 1234567)]
laser = sent(TSL570, 1550.1234, "wavelength_setpoint")
print("pymeasure", version("pymeasure"), "sends for 123.456, 123.4567 and 1234567:", stage, "for 1550.1234:", laser)
assert stage == ["1PA123.456", "1PA123.457", "1PA1.23457e+06"], "the stage: the behaviour has changed"
assert laser.endswith(" 1550.12"), "the laser: the behaviour has changed"
PY
