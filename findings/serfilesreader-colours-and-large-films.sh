#!/usr/bin/env bash
# A good guess: serfilesreader gives the frames of a SER film (what programs for astronomical cameras record), colours too, since its page says
# that it reads colour identifiers up to RGB; and frames are found wherever they lie. Found: of a coloured frame the first third comes, as a
# grey picture of the right size (three channels of one pixel become three pixels). From 4 GiB on frames come round: frame 128 of 32 MiB
# each is frame 0, with a warning on a multiplication. And setLittleEndian(0) writes 0 as the film's width.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --disable-pip-version-check serfilesreader==0.0.8 numpy==2.4.6 opencv-python-headless==5.0.0.93 astropy==8.0.2
v/bin/python - <<'PY'
import struct
import warnings
from importlib.metadata import version

import numpy as np
from serfilesreader import Serfile


def begin(name, width, height, frames, colour, depth):
    """Write a SER film's 178 bytes of header (version 3)."""
    file = open(name, "wb")
    file.write(b"LUCAM-RECORDER" + struct.pack("<7i", 0, colour, 0, width, height, depth, frames) + b" " * 120 + bytes(16))
    return file


RGB, GREY = 100, 0
coloured = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
with begin("coloured.ser", 4, 2, 1, RGB, 8) as file:
    file.write(coloured.tobytes())
read = Serfile("coloured.ser").readFrameAtPos(0)
print("serfilesreader", version("serfilesreader"), "a frame of 2 x 4 pixels of three channels:", read.tolist())
assert np.array_equal(read.ravel(), coloured.ravel()[:8]), "colours: the behaviour has changed"

SIDE, FRAMES = 4096, 131
with begin("large.ser", SIDE, SIDE, FRAMES, GREY, 16) as file:
    for number in range(FRAMES):
        file.seek(178 + number * SIDE * SIDE * 2)
        file.write(struct.pack("<H", number))
    file.truncate(178 + FRAMES * SIDE * SIDE * 2)
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    film = Serfile("large.ser")
    found = {number: int(film.readFrameAtPos(number)[0, 0]) for number in (0, 2, 127, 128, 130)}
print(f"frames of {SIDE} x {SIDE} pixels of 16 bits, asked for: found", found, {str(warning.message) for warning in said})
assert found == {0: 0, 2: 2, 127: 127, 128: 0, 130: 2}, "large films: the behaviour has changed"

film = Serfile("new.ser", NEW=True)
film.setImageWidth(640)
film.setLittleEndian(0)
width = int(film.getWidth())
print("width of 640 after setLittleEndian(0):", width)
assert width == 0, "a film's header: the behaviour has changed"
PY
