#!/usr/bin/env bash
# A good guess: thorlabs-apt-protocol decodes the status bits of a motor as the APT protocol guide lists them, the four
# digital inputs (0x00100000, 0x00200000, 0x00400000, 0x00800000) among them.
# Found: the third input is said to be on when the first or the second is; its own bit is reported as the fourth's, and
# the fourth's bit (0x00800000) is the only one of 32 that nothing answers to. A switch at the end of travel on the fourth
# input looks as if it never closed, one on the first as if two were.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet thorlabs-apt-protocol==29.0.0
"$folder/venv/bin/python" - <<'PY'
import io
import struct
from importlib.metadata import version

import thorlabs_apt_protocol as apt


def status(bits):
    message = struct.pack("<HHBB", 0x0481, 14, 0x81, 0x50) + struct.pack("<HllL", 1, 0, 0, bits)
    return next(iter(apt.Unpacker(io.BytesIO(message))))._asdict()


nothing = status(0)
mute = [bit for bit in range(32) if status(1 << bit) == nothing]
inputs = [status(1 << bit)["dig_ins"] for bit in range(20, 24)]
print("thorlabs-apt-protocol", version("thorlabs-apt-protocol"), "bits without effect:", mute)
for bit, read in zip(range(20, 24), inputs, strict=True):
    print(f"0x{1 << bit:08x}", read)
expected = [[True, False, True, False], [False, True, True, False], [False, False, False, True], [False] * 4]
assert mute == [23] and inputs == expected, "the behaviour has changed"
PY
