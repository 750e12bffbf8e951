#!/usr/bin/env bash
# A good guess: zaber.serial, which encodes numbers of four bytes, refuses those that do not fit into the three that are left where messages are
# numbered (Zaber's binary protocol manual: the last byte is then the message's number). Found: it drops the upper byte. A command to
# go to 10,000,000 microsteps is one to -6,777,216, and 16,777,216 is 0, without a word; unnumbered they are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check zaber.serial==0.9.1 pyserial==3.5
v/bin/python - <<'PY'
from importlib.metadata import version

from zaber.serial import BinaryCommand, BinaryReply

MOVE_ABSOLUTE = 20
asked = [1000, -1000, 8_388_607, 10_000_000, 16_777_216]
plain = [BinaryReply(BinaryCommand(1, MOVE_ABSOLUTE, steps).encode()).data for steps in asked]
numbered = [
    BinaryReply(BinaryCommand(1, MOVE_ABSOLUTE, steps, message_id=5).encode(), message_id=True).data for steps in asked
]
print("zaber.serial", version("zaber.serial"), "asked", asked, "unnumbered", plain, "numbered", numbered)
assert plain == asked, "unnumbered: the behaviour has changed"
assert numbered == [1000, -1000, 8_388_607, -6_777_216, 0], "numbered: the behaviour has changed"
PY
