#!/usr/bin/env bash
# A good guess: mdt69x, which drives Thorlabs' piezo controllers MDT693B and MDT694B, sets and reads the limits of each axis and of all three by
# functions of those names. Found: the second of two functions set_z_voltage_min() stands where the one for all axes should: the lower limit
# of z goes out as SYSMIN and is that of x, y and z, no function sets z's own, and get_sys_voltage_min() reads z's.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check mdt69x==1.0.11 pyserial==3.5
v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import mdt69x
import serial


class Piezo:
    """An MDT693B by its list of commands: lower and upper limits of x, y and z, and of all of them; replies end with a prompt."""

    def __init__(self):
        self.limits = dict.fromkeys(("XL", "YL", "ZL", "SYSMIN"), 0.0) | dict.fromkeys(("XH", "YH", "ZH", "SYSMAX"), 150.0)
        self.sent, self.reply = [], b""

    def write(self, line):
        command = line.decode().strip()
        self.sent.append(command)
        self.reply = b"*"
        for name in self.limits:
            if command == name + "?":
                self.reply = b"[ %.2f]*" % self.limits[name]
            elif command.startswith(name):
                self.limits[name] = float(command[len(name) :].lstrip("="))

    def read(self, _count):
        return b"!"

    def read_until(self, _end):
        return self.reply

    def close(self):
        pass

    open = flushInput = close
    setDTR = setRTS = lambda self, _level: None


serial.Serial = Piezo
controller = mdt69x.Controller("port")
piezo = controller._ser
piezo.sent.clear()
controller.set_x_voltage_min(5)
controller.set_z_voltage_min(20)
sent = list(piezo.sent)
piezo.limits |= {"ZL": 7.0, "SYSMIN": 20.0}
read = controller.get_sys_voltage_min(), controller.get_z_voltage_min()
print("mdt69x", version("mdt69x"), "sent for lower limits of x and z:", sent, "and read for one of 20 of all axes and 7 of z:", read)
assert sent == ["XL5", "SYSMIN=20"], "setting limits: the behaviour has changed"
assert read == (7.0, 7.0), "reading limits: the behaviour has changed"
assert not hasattr(controller, "set_sys_voltage_min") and controller.get_sys_voltage_max() == 150
PY
