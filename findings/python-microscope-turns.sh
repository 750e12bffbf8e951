#!/usr/bin/env bash
# A good guess: python-microscope turns a camera's pictures as its user asks, whatever the readout's own order is, which the driver has told it to
# undo before: a mirrored readout, turned by 90 degrees, is the mirrored picture turned. Found: mirrors and turns are combined as if
# their order did not matter: where one axis is mirrored by the readout and the user asks for a turn, the picture is upside down (16 of the
# 64 combinations). Beside it: a CoolLED's power of 0.29 is set as 28 per cent, and 0.57 as 56: the product is cut, not rounded.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check microscope==0.7.0 numpy==2.4.6 scipy==1.17.1
v/bin/python - <<'PY'
import itertools
import os
import pty
import threading
import tty
from importlib.metadata import version

import numpy as np
from microscope.controllers.coolled import CoolLED
from microscope.simulators import SimulatedCamera

picture = np.arange(6).reshape(2, 3)


def turned(picture, by_user, by_readout=(False, False, False)):
    """Return the picture as the camera gives it; (mirror left to right, mirror top to bottom, turn), as its driver and user ask."""
    camera = SimulatedCamera()
    camera._set_readout_transform(by_readout)  # what drivers call, for instance pvcam's for each port of a chip
    camera.set_transform(by_user)
    return camera._process_data(picture)


ways = list(itertools.product((False, True), repeat=3))
upside_down = []
for readout, user in itertools.product(ways, ways):
    one_after_the_other = turned(turned(picture, readout), user)
    found = turned(picture, user, readout)
    if not np.array_equal(found, one_after_the_other):
        assert np.array_equal(found, one_after_the_other[::-1, ::-1]), "the behaviour has changed"
        upside_down.append((readout, user))
print("microscope", version("microscope"), "combinations of 64 that come out upside down:", len(upside_down))
mirror, turn = (True, False, False), (False, False, True)
print("mirrored and turned", turned(turned(picture, mirror), turn).tolist(), "found", turned(picture, turn, mirror).tolist())
assert upside_down == [(r, u) for r in ways for u in ways if r[0] != r[1] and u[2]], "the behaviour has changed"

device, name = pty.openpty()
tty.setraw(device)
state = b"ASF000"


def answer():
    """Play a CoolLED of one channel: "CSS?" asks for its state, and "CSS..." sets it."""
    global state
    line = b""
    while True:
        line += os.read(device, 1)
        if line.endswith(b"\n"):
            if line.startswith(b"CSS") and line[3:4] != b"?":
                state = line[3:-1]
            os.write(device, b"CSS" + state + b"\r\n")
            line = b""


threading.Thread(target=answer, daemon=True).start()
light = CoolLED(os.ttyname(name)).devices["A"]
found = []
for power in (0.28, 0.29, 0.57, 0.6):
    light._do_set_power(power)
    found.append(int(state[3:]))
print("a CoolLED's power of 0.28, 0.29, 0.57 and 0.6 is set as", found, "per cent")
assert found == [28, 28, 56, 60], "powers: the behaviour has changed"
PY
