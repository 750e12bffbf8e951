#!/usr/bin/env bash
# A good guess: Luxbeam (the package for Visitech's DMD controllers) writes sequences as they are asked for, and takes a picture of each
# DMD that it names. Found: wait(400), 400 microseconds, becomes "Wait 4 0 0" (the digits are three parameters; wait(5) is right), a loop over
# one number of pictures, range_loop_iter(8), is refused as empty, and no picture can be loaded into its XGA types: 768 rows are no
# multiple of the 11 that it puts in a packet. Seen in the text of the sequence and at a controller that a socket plays: it answers
# message 315, as the package reads the answer, with 1024 x 768.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check luxbeam==0.1.2 numpy==2.4.6
v/bin/python - <<'PY'
import socket
import struct
import threading
from importlib.metadata import version

import numpy as np
from Luxbeam import Luxbeam, LuxbeamSequencer

sequence = LuxbeamSequencer()
sequence.wait(5)
sequence.wait(400)
lines = sequence.dumps().splitlines()

try:
    looped = list(LuxbeamSequencer().range_loop_iter(8))
except ValueError:
    looped = "refused"

controller = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
controller.bind(("127.0.0.1", 52985))


def answer():
    while True:
        message, sender = controller.recvfrom(2048)
        number = struct.unpack(">HH", message[:4])[1]
        content = struct.pack(">HHHHH", 3, 16, 1024, 768, 48) if number == 315 else struct.pack(">I", 0)
        controller.sendto(struct.pack(">HH", 4 + len(content), 515 if number == 315 else 501) + content, sender)


threading.Thread(target=answer, daemon=True).start()
board = Luxbeam("127.0.0.1", timeout=10)
try:
    board.load_image(0, np.ones((board.rows, board.cols), dtype=bool))
    loaded = "taken"
except AssertionError:
    loaded = "refused by an assertion"
print("luxbeam", version("luxbeam"), "waits", lines, "loop over 8", looped, "picture of", (board.rows, board.cols), loaded)
assert lines == ["Wait 5", "Wait 4 0 0"], "waits: the behaviour has changed"
assert looped == "refused", "loops: the behaviour has changed"
assert loaded == "refused by an assertion", "pictures: the behaviour has changed"
PY
