#!/usr/bin/env bash
# A good guess: PyVISA's write_ascii_values() sends each number with the digits that it has, or in a form with an exponent, as instruments take them
# and as query_ascii_values() reads them. Found: unless told, it sends six digits after the point: an exposure of 150 ns and a
# current of 2 nA are sent as 0.000000, and a delay of 1.4 us as 0.000001. converter="e" keeps seven digits, repr all.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --disable-pip-version-check pyvisa==1.16.2 pyvisa-py==0.8.1 pyserial==3.5
v/bin/python - <<'PY'
import socket
import threading
from importlib.metadata import version

import pyvisa

server = socket.create_server(("127.0.0.1", 0))
lines = []


def keep():
    """Play an instrument that keeps the lines that it is sent."""
    link, _ = server.accept()
    with link.makefile() as file:
        lines.extend(line.strip() for line in file)


player = threading.Thread(target=keep)
player.start()
manager = pyvisa.ResourceManager("@py")
device = manager.open_resource(f"TCPIP0::127.0.0.1::{server.getsockname()[1]}::SOCKET", write_termination="\n")
device.write_ascii_values("LIST ", [150e-9, 2e-9, 1.4e-6, 12.3456789])
device.write_ascii_values("LIST ", [150e-9, 2e-9, 1.4e-6, 12.3456789], converter="e")
device.write_ascii_values("LIST ", [150e-9, 2e-9, 1.4e-6, 12.3456789], converter=repr)
device.close()
player.join()
print("PyVISA", version("pyvisa"), *lines, sep="\n")
assert lines[0] == "LIST 0.000000,0.000000,0.000001,12.345679", "the behaviour has changed"
assert lines[1] == "LIST 1.500000e-07,2.000000e-09,1.400000e-06,1.234568e+01", "exponents: the behaviour has changed"
assert lines[2] == "LIST 1.5e-07,2e-09,1.4e-06,12.3456789", "repr: the behaviour has changed"
PY
