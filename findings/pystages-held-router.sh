#!/usr/bin/env bash
# A good guess: pystages reads the position of a Grbl stage in each of the states that Grbl 1.1 reports. Found: only in Idle, Run, Home, Check
# and Alarm. A held one reports "Hold:0" (0: it stands, 1: it still brakes), an open door "Door:0" to "Door:3", a jog "Jog", a
# resting one "Sleep": the position, and whether it moves, are a ValueError then, among them in each move by $J. Seen at a serial line
# that a pseudo-terminal plays, with lines as Grbl writes them (its interface.md, "Real-time status reports").
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pystages==1.4.2 pyserial==3.5
v/bin/python - <<'PY'
import os
import pty
import threading
import tty
from importlib.metadata import version

from pystages import CNCRouter

board, line = pty.openpty()
tty.setraw(line)
state = "Idle"


def answer():
    while True:
        for _ in range(os.read(board, 64).count(b"?")):
            os.write(board, f"<{state}|MPos:1.000,2.000,3.000|FS:0,0|WCO:0.000,0.000,0.000>\r\n".encode())


threading.Thread(target=answer, daemon=True).start()
stage = CNCRouter(os.ttyname(line), do_reset=False)
read = {}
for state in ("Idle", "Run", "Home", "Check", "Alarm", "Hold:0", "Door:0", "Jog", "Sleep"):
    try:
        read[state] = stage.position.data
    except ValueError as error:
        read[state] = str(error)
    print("pystages", version("pystages"), state, read[state])
refused = [state for state, position in read.items() if position != [1, 2, 3]]
assert refused == ["Hold:0", "Door:0", "Jog", "Sleep"], "the behaviour has changed"
PY
