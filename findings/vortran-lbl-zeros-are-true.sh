#!/usr/bin/env bash
# A good guess: vortran-lbl, for Vortran's Stradus lasers, has on_off False of a laser that is off, and control_mode False of one that holds its
# power. Found: both are True, whatever the laser answers, for the answer is a text, and "0" is one that is not empty: a program that asks whether
# the beam is off is told that it is on. And `current` is always an UnboundLocalError, its name being misspelt. power is right. The
# laser is a stand-in at the level of USB transfers.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps vortran-lbl==1.0.0 pyusb==1.3.1
v/bin/python - <<'PY'
from importlib.metadata import version

from vortran_lbl.laser import Laser
from vortran_lbl.usb import VortranDevice


class Connection:
    """A laser: it takes A0 with a command, says by A1 that an answer is there, and gives it after A2."""

    def __init__(self):
        self.values, self.answer, self.next = {"LE": "0", "C": "0", "LP": "020.0", "LC": "050.0"}, "", b""

    def ctrl_transfer(self, kind, request, value, index, data):
        """Take one report of 64 bytes."""
        report = bytes(data)
        if report[0] == 0xA0:
            command = report[1:].split(b"\r\n")[0].decode()
            name = command.lstrip("?").split("=")[0]
            if "=" in command:
                self.values[name] = command.split("=")[1]
            self.answer = f"\r\n{'?' if command.startswith('?') else ''}{name}={self.values[name]}\r\nStradus: 1>"
        self.next = {0xA1: b"\1\xff", 0xA2: b"\xa2" + self.answer.encode()}.get(report[0], b"")

    def read(self, endpoint, size, timeout):
        """Give the report that is due."""
        due, self.next = self.next, b""
        return due.ljust(size, b"\0")


laser = Laser(VortranDevice(0x201A, 0x0003, 1, 1), 500)
laser.connection = Connection()
found = {}
for state in ("off", "on"):
    getattr(laser, state)()
    found[state] = laser.on_off
modes = {}
for mode in ("power", "current"):
    getattr(laser, f"enable_{mode}_control_mode")()
    modes[mode] = laser.control_mode
print("vortran-lbl", version("vortran-lbl"), "the laser has", laser.connection.values, "; on_off", found, "; control_mode", modes, "; power", laser.power)
unbound = False
try:
    laser.current
except UnboundLocalError as error:
    unbound = True
    print("current:", error)
laser.off()
assert laser.connection.values["LE"] == "0" and laser.power == 20
assert found == {"off": True, "on": True} and modes == {"power": True, "current": True}, "the behaviour has changed"
assert unbound, "current: the behaviour has changed"
PY
