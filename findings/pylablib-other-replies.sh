#!/usr/bin/env bash
# A good guess: what pylablib's drivers return is what the devices say. Found: of a Toptica iBeam's "100 h + 1800 s" the seconds are never read, and 100 h
# are 100.03; after set_relay_setpoints(2, ...) a KJL 300 pressure gauge's relay 1 is returned, as if relay 2 had not taken what was set; and
# a Picomotor 8742 that has found two controllers with one address (135, the manual's example: bit 0 is set) has no conflict.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps pylablib==1.4.5 pyserial==3.5 pyusb==1.3.1 numpy==2.4.6 scipy==1.17.1 pandas==3.1.1 python-dateutil==2.9.0.post0 six==1.17.0
v/bin/python - <<'PY'
import os
import pty
import threading
import tty
from importlib.metadata import version

from pylablib.devices import KJL, Newport, Toptica


def line(answer, end):
    """The name of a serial line at whose other end `answer` says what to reply to a line, or None."""
    device, computer = pty.openpty()
    tty.setraw(device), tty.setraw(computer)

    def play():
        waiting = b""
        while True:
            waiting += os.read(device, 1000)
            *asked, waiting = waiting.split(end)
            for one in asked:
                reply = answer(one.decode().strip())
                if reply is not None:
                    os.write(device, reply.encode())

    threading.Thread(target=play, daemon=True).start()
    return os.ttyname(computer)


def laser(asked):
    says = {"status uptime": "PowerUP: 100 h + 1800 s\r\nLaserON: 50 h + 900 s\r\n", "show level power": "CH1, PWR:  1.000 mW\r\n"}
    return says.get(asked, "") + "[OK]\r\n"


relays = {"L+": "1.00E-03", "L-": "2.00E-03", "H+": "1.00E+01", "H-": "2.00E+01"}


def gauge(asked):
    command = asked[3:]
    if command == "RST":
        return None
    if command[0] == "R":
        return f"*01 {relays[command[1:]]}\r"
    if command[0] == "S" and command[1:3] in relays:
        relays[command[1:3]] = command[3:]
    return "*01 1.00\r" if command == "VER" else "*01 PROGM OK\r"


def motors(asked):
    return {"*IDN?": "New_Focus 8742 v2.2 08/01/13 11511\r\n", "SC?": "135\r\n"}.get(asked)


hours = Toptica.TopticaIBeam(line(laser, b"\n")).get_work_hours()
returned = KJL.KJL300(line(gauge, b"\r")).set_relay_setpoints(2, on=133.322, off=266.644)
addresses, conflict = Newport.Picomotor8742((line(motors, b"\n"), 115200), backend="serial").get_addr_map()
print("pylablib", version("pylablib"), hours)
print("relay 2 set to 1 and 2 Torr,", relays["H+"], relays["H-"], "at the gauge; returned", [round(pascals / 133.322, 6) for pascals in returned], "Torr")
print("135: addresses", addresses, "conflict", conflict)
assert abs(hours.power_up - (100 + 100 / 3600)) < 1e-6 and abs(hours.laser_on - (50 + 50 / 3600)) < 1e-6, "hours: the behaviour has changed"
assert (relays["H+"], relays["H-"]) == ("1.00E+00", "2.00E+00")
assert abs(returned[0] - 0.133322) < 1e-6 and abs(returned[1] - 0.266644) < 1e-6, "relays: the behaviour has changed"
assert (addresses, conflict) == ([1, 2, 7], False), "addresses: the behaviour has changed"
PY
