#!/usr/bin/env bash
# A good guess: set_voltage(5) and set_current(2) of pylablib's driver of Rigol's DP1116A set the power supply, and return what is set.
# Found: both send MEAS:VOLT 5.0000 and MEAS:CURR 2.0000, the header of a measurement, which sets nothing, where SOURCE:VOLT and SOURCE:CURR
# set, and are what the setpoints are read from; and they return what the outputs measure. No error comes from the driver; the supply stays as it was.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps pylablib==1.4.5 numpy==2.4.6 scipy==1.17.1 pandas==3.1.1 python-dateutil==2.9.0.post0 six==1.17.0
v/bin/python - <<'PY'
import socketserver
import threading
from importlib.metadata import version

from pylablib.devices import Rigol

setpoints, sent = {"SOURCE:VOLT": "1.0000", "SOURCE:CURR": "0.1000"}, []
answers = {"*IDN?": "RIGOL TECHNOLOGIES,DP1116A,0,1", "MEAS:VOLT?": "0.9998", "MEAS:CURR?": "0.0200"}


class Supply(socketserver.StreamRequestHandler):
    """The supply: it keeps setpoints, and a header of a measurement has no form that sets."""

    def handle(self):
        for line in self.rfile:
            command, _, value = line.decode().strip().partition(" ")
            if command.endswith("?"):
                self.wfile.write((answers.get(command) or setpoints[command[:-1]]).encode() + b"\r\n")
            else:
                sent.append(f"{command} {value}")
                if command in setpoints:
                    setpoints[command] = value


server = socketserver.ThreadingTCPServer(("127.0.0.1", 0), Supply)
server.daemon_threads = True
threading.Thread(target=server.serve_forever, daemon=True).start()
supply = Rigol.DP1116A(f"127.0.0.1:{server.server_address[1]}")
returned = supply.set_voltage(5), supply.set_current(2)
print("pylablib", version("pylablib"), "sends", sent, "returns", returned)
print("setpoints afterwards:", supply.get_voltage_setpoint(), "V,", supply.get_current_setpoint(), "A")
assert sent == ["MEAS:VOLT 5.0000", "MEAS:CURR 2.0000"] and returned == (0.9998, 0.02), "the behaviour has changed"
assert (supply.get_voltage_setpoint(), supply.get_current_setpoint()) == (1.0, 0.1)
PY
