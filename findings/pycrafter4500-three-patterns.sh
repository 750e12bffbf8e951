#!/usr/bin/env bash
# A good guess: pycrafter4500's pattern_mode(num_pats=24, bit_depth=1) shows the 24 binary patterns that a picture of 24 bits holds, one after
# the other. Found: it tells a LightCrafter 4500 of 24 patterns and describes three, the highest plane of each colour; the other 21 are what the
# board had before. Seen at the USB device that it writes to, a stand-in here: command 0x1A 0x31 (number of patterns, less one), 0x1A 0x34
# (description of one), TI DLPU010.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pycrafter4500==0.7 pyusb==1.3.1
v/bin/python - <<'PY'
from importlib.metadata import version

import usb.core


class Board:
    def __init__(self):
        self.written = []

    def write(self, endpoint, content):
        self.written.append(bytes(content))

    def read(self, endpoint, length):
        return bytes(length)

    def set_configuration(self):
        pass

    def reset(self):
        pass


board = Board()
usb.core.find = lambda **names: board
import pycrafter4500

pycrafter4500.pattern_mode(num_pats=24, bit_depth=1, led_color=0b111)
told = [content[6] + 1 for content in board.written if content[4:6] == b"\x31\x1a"]
planes = [content[6] >> 2 for content in board.written if content[4:6] == b"\x34\x1a"]
print("pycrafter4500", version("pycrafter4500"), "told of", told, "patterns, described planes", planes)
assert told == [24] and planes == [7, 15, 23], "the behaviour has changed"
PY
