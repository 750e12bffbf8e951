#!/usr/bin/env bash
# A good guess: a stage behind a serial server (pyserial's "socket://") is read as one on a cable: `in_waiting` counts the bytes
# that have come, and what a socket has not, control lines, is False or refused.
# Found: `in_waiting` is 1 whether 1 or 1,000 bytes have come, so that the usual `read(in_waiting)` cuts an answer after its
# first byte; `cts`, `dsr` and `cd` are True always, as if a device were there and ready; `out_waiting` is not refused as
# the line's other lacks are but missing from the class (AttributeError).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pyserial==3.5
"$folder/venv/bin/python" - <<'PY'
import socket
import time

import serial

server = socket.create_server(("127.0.0.1", 0))
line = serial.serial_for_url(f"socket://127.0.0.1:{server.getsockname()[1]}", timeout=5)
device, _ = server.accept()
device.sendall(b"<Idle|MPos:0.000,0.000,0.000>\r\n" * 30)
time.sleep(0.5)
waiting = line.in_waiting
first = line.read(waiting)
rest = line.read(30 * 31 - len(first))
lines = (line.cts, line.dsr, line.cd)
print("pyserial", serial.__version__, "in_waiting", waiting, "of", len(first) + len(rest), "bytes; read(in_waiting)", first,
      "; cts, dsr, cd", lines, "; has out_waiting:", hasattr(line, "out_waiting"))
assert len(first) + len(rest) == 930, "not all had come"
assert waiting == 1 and lines == (True, True, True) and not hasattr(line, "out_waiting"), "the behaviour has changed"
PY
