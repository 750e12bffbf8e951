#!/usr/bin/env bash
# A good guess: pycine's `start_frame_cine` reads a film of a Phantom camera from the picture on that bears this number; the camera counts
# from the trigger, so that 0 is the picture of the trigger and what came before is negative. Found: reading begins one picture before the
# one asked for, and before the first comes the last; and 0 counts as nothing given: the film is read from its beginning.
# Beside it: values are stretched from black to white level by cutting digits off, so that most of them are one lower than they should be.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pycine==0.3.2 numpy==2.4.6
v/bin/python - <<'PY'
import ctypes
import struct
from importlib.metadata import version

import numpy as np
from pycine import cine
from pycine.raw import read_frames

HEIGHT, WIDTH, BLACK, WHITE, FIRST = 2, 4, 64, 4064, -3
films = [np.full((HEIGHT, WIDTH), 1100 * number, "<u2") for number in (1, 2, 3, 4)]
head, bitmap, setup = cine.CINEFILEHEADER(), cine.BITMAPINFOHEADER(), cine.SETUP()
sizes = [ctypes.sizeof(part) for part in (head, bitmap, setup)]
head.Type, head.Headersize, head.Version = int.from_bytes(b"CI", "little"), sizes[0], 1
head.FirstMovieImage = head.FirstImageNo = FIRST
head.TotalImageCount = head.ImageCount = len(films)
head.OffImageHeader, head.OffSetup, head.OffImageOffsets = sizes[0], sum(sizes[:2]), sum(sizes)
bitmap.biSize, bitmap.biWidth, bitmap.biHeight, bitmap.biPlanes, bitmap.biBitCount = sizes[1], WIDTH, HEIGHT, 1, 16
setup.RealBPP, setup.BlackLevel, setup.WhiteLevel = 12, BLACK, WHITE
pictures = [struct.pack("<II", 8, film.nbytes) + film[::-1].tobytes() for film in films]  # rows from the bottom up
begin = sum(sizes) + 8 * len(films)
offsets = struct.pack("<4q", *(begin + number * len(pictures[0]) for number in range(4)))
with open("film.cine", "wb") as file:
    file.write(bytes(head) + bytes(bitmap) + bytes(setup) + offsets + b"".join(pictures))


def read(**chosen):
    frames, _, _ = read_frames("film.cine", **chosen)
    return [int(round((float(frame[0, 0]) * (WHITE - BLACK) / 4095 + BLACK) / 1100)) for frame in frames]


whole, first, third = read(), read(start_frame_cine=FIRST, count=4), read(start_frame_cine=FIRST + 2, count=2)
trigger = read(start_frame_cine=0, count=1)
print("pycine", version("pycine"), "pictures read:", whole, "from the first by its number on:", first, "from the third on:", third)
print("the picture of the trigger, the fourth:", trigger)
assert whole == [1, 2, 3, 4], "the behaviour has changed"
assert first == [4, 1, 2, 3] and third == [2, 3], "the behaviour has changed"
assert trigger == [1], "the behaviour has changed"
frame = next(read_frames("film.cine")[0])
exact = (1100 - BLACK) * 4095 / (WHITE - BLACK)
print(f"1100 counts become {frame[0, 0]}, exactly {exact:.3f}")
assert frame[0, 0] == int(exact) != round(exact), "the behaviour has changed"
PY
