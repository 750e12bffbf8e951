#!/usr/bin/env bash
# A good guess: aries-controller, for Kohzu's four-axis motor controllers, stops axes that still move when its object goes, so that Ctrl-C is an
# emergency stop, as it says, unless ignore_safety_stop is set, which is False at first. Found: the other way round: at first nothing is
# stopped and the axes go on; with ignore_safety_stop = True all four are stopped at once. And degrees are cut to pulses, not rounded:
# 2.03 degrees, 1015 pulses, are sent as 1014. The controller is a stand-in on a socket, which answers STR and RDP as the library reads them.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps aries-controller==0.7.0
v/bin/python -W ignore - <<'PY'
import gc
import socketserver
import threading
from importlib.metadata import version

from aries import Aries

heard = []


class Controller(socketserver.StreamRequestHandler):
    """Four axes, of which the first moves until it is stopped."""

    def handle(self):
        """Answer each line."""
        moving = True
        while line := self.rfile.readline().decode().strip():
            heard.append(line)
            if line.startswith("STP1"):
                moving = False
            value = {"STR": int(moving and line == "STR1"), "RDP": 0}.get(line[:3], 0)
            self.wfile.write(f"C\t{line.split('/')[0]}\t{value}\r\n".encode())


socketserver.ThreadingTCPServer.allow_reuse_address = True
found = {}
with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Controller) as server:
    threading.Thread(target=server.serve_forever, daemon=True).start()
    for ignore in (None, False, True):
        stage = Aries("127.0.0.1", server.server_address[1])
        if ignore is not None:
            stage.ignore_safety_stop = ignore
        stage.position = (2.03, 0, 0, 0)
        moves = [line for line in heard if line.startswith("APS")]
        heard.clear()
        del stage
        gc.collect()
        found[ignore] = [line for line in heard if line.startswith("STP")]
        heard.clear()
        print("aries-controller", version("aries-controller"), f"ignore_safety_stop {'as it is' if ignore is None else ignore}: moved by {moves}; as the object goes it sends {found[ignore] or 'no stop'}")
    server.shutdown()
assert moves == ["APS1/5/1014/1"], "pulses: the behaviour has changed"
assert found[None] == found[False] == [] and found[True] == [f"STP{axis}/1" for axis in (1, 2, 3, 4)], "the behaviour has changed"
PY
