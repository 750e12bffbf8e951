#!/usr/bin/env bash
# A good guess: pyrga, for Stanford Research's residual gas analyzers, lights the filament with the emission that set_emission_current() was given, and
# raises the errors that the analyzer reports in its status byte, of which it has a list. Found: an emission that is given is checked and forgotten: with
# 0.5 mA asked for the filament gets 1 mA, the default; given as the object is made, turn_on_filament() is an AttributeError. And no reported error
# is ever raised, whichever bit is set, as by a filament that has burnt out, for numbers are compared with the text "1". The analyzer is
# a stand-in on a serial line, after the commands of its manual.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps pyrga==0.0.3 pyserial==3.5
v/bin/python - <<'PY'
import logging
from importlib.metadata import version

import pyrga.driver
import serial


class Analyzer:
    """An SRS RGA100: it answers queries with what was set, and settings of its filament, multiplier and calibration with a status byte."""

    def __init__(self, *values, **named):
        self.values = {"ID": "SRSRGA100VER0.24SN12345", "SP": "0.1", "ST": "10", "FL": "0.00", "EE": "70", "IE": "1", "VF": "90", "NF": "4"}
        self.status, self.waiting, self.sent = 0, b"", []

    @property
    def in_waiting(self):
        return len(self.waiting)

    def write(self, line):
        command, value = line.decode()[:2], line.decode()[2:].strip()
        self.sent.append(command + value)
        reports = command in pyrga.driver.RGAClient._STATUS_REPORTING_COMMANDS
        if command == "EM":
            self.waiting += b"\1\n\r"
        elif value == "?":
            self.waiting += self.values[command].encode() + b"\n\r"
        else:
            if value not in ("", "*"):
                self.values[command] = value
            if reports:
                self.waiting += bytes([self.status]) + b"\n\r"
        return len(line)

    def read(self, count=1):
        part, self.waiting = self.waiting[:count], self.waiting[count:]
        return part

    def readline(self):
        return self.read(self.waiting.index(b"\n") + 1)


serial.Serial = Analyzer
logging.disable(logging.INFO)
pyrga.driver.time.sleep = lambda seconds: None
client = pyrga.driver.RGAClient("line")
line = client._com_obj
client.set_emission_current(0.5)
client.turn_on_filament()
lit = [command for command in line.sent if command.startswith("FL") and command != "FL?"]
print("pyrga", version("pyrga"), "0.5 mA asked for: sent", lit, "; the analyzer reads", client.get_emission_current())
missing = False
other = pyrga.driver.RGAClient("line", emission_current_mA=0.5)
try:
    other.turn_on_filament()
except AttributeError as error:
    missing = True
    print("0.5 mA as it is made:", error)
raised = []
for bit in range(8):
    line.status = 1 << bit
    try:
        client.turn_off_filament()
        client.turn_on_filament()
    except pyrga.driver.RGAException as error:
        raised.append((bit, str(error)))
print("errors raised when each bit of the status byte is set:", raised)
assert lit == ["FL1.0"], "emission: the behaviour has changed"
assert missing, "emission as it is made: the behaviour has changed"
assert raised == [], "errors: the behaviour has changed"
PY
