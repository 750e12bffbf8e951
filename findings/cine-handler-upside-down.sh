#!/usr/bin/env bash
# A good guess: cine-handler reads the films of Phantom cameras as Vision Research's format has them: rows from the bottom up where the height is positive,
# 10 bits packed where the compression says so, and a part of a film that it saves keeps each picture's own time. Found: pictures that are not
# packed come upside down, whatever the height's sign; those of a 10-bit camera that lie in 16 bits are unpacked all the same, to other
# values at other places, without a word; and a saved part carries the times of the whole film, so that its first picture has the first one's.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps cine-handler==0.1.1 numpy==2.4.6
v/bin/python - <<'PY'
import struct
from importlib.metadata import version
from pathlib import Path

import numpy as np
from cine_reader import Cine

SETUP = 10688  # bytes of the block of settings, as of software 2021


def write(name, pictures, first, seconds, bits, height_sign=1):
    """Write pictures, top row first, as an uncompressed film with a block of times (1002) behind the settings."""
    height, width = pictures[0].shape
    count, begin, setup = len(pictures), 44 + 40, bytearray(SETUP)
    times = struct.pack("<IHH", 8 + 8 * count, 1002, 0) + b"".join(struct.pack("<II", round(s % 1 * 2**32), int(s)) for s in seconds)
    offsets = begin + SETUP + len(times)
    struct.pack_into("<2sH", setup, 140, b"ST", SETUP)
    struct.pack_into("<HH", setup, 737, width, height)
    struct.pack_into("<I", setup, 896, bits)
    struct.pack_into("<d", setup, 10400, 100.0)
    head = struct.pack("<2sHHHiIiIIIIQ", b"CI", 44, 0, 1, first, count, first, count, 44, begin, offsets, int(seconds[0]) << 32)
    bitmap = struct.pack("<IiiHHIIiiII", 40, width, height_sign * height, 1, 16, 0, 2 * width * height, 0, 0, 0, 0)
    rows = -1 if height_sign > 0 else 1
    data = [struct.pack("<II", 8, 2 * width * height) + picture[::rows].astype("<u2").tobytes() for picture in pictures]
    table = struct.pack(f"<{count}q", *(offsets + 8 * count + number * len(data[0]) for number in range(count)))
    Path(name).write_bytes(head + bitmap + setup + times + table + b"".join(data))


def times(name):
    """Return the seconds in a film's block of times."""
    data = Path(name).read_bytes()
    size, kind = struct.unpack_from("<IH", data, 84 + SETUP)
    assert kind == 1002
    return [whole + part / 2**32 for part, whole in struct.iter_unpack("<II", data[84 + SETUP + 8 : 84 + SETUP + size])]


picture = np.arange(20).reshape(4, 5) * 10
films = [picture + number for number in range(4)]
found = {}
for sign in (1, -1):
    write("film.cine", films, -2, [1000.0, 1000.25, 1000.5, 1000.75], 12, sign)
    with Cine("film.cine") as film:
        film.load_frame(-2)
        found[sign] = film.image[:, 0].tolist()
print("cine-handler", version("cine-handler"), "first column, 0 to 150 from the top, of height 4:", found[1], "of height -4:", found[-1])
assert found == {1: [150, 100, 50, 0], -1: [0, 50, 100, 150]}, "rows: the behaviour has changed"

with Cine("film.cine") as film:
    film.save_frames_to_new_file("part.cine", 0, 1)
with Cine("part.cine") as part:
    part.load_frame(0)
    value = int(part.image.min())
print("the third picture's time:", times("film.cine")[2], "; in a film of the last two, value", value, "number 0, times", times("part.cine"))
assert value == 2 and times("part.cine") == [1000.0, 1000.25, 1000.5, 1000.75], "times: the behaviour has changed"

write("ten.cine", films, -2, [1000.0, 1000.25, 1000.5, 1000.75], 10, -1)
with Cine("ten.cine") as film:
    film.load_frame(-2)
    ten = film.image
print("a picture of 10 bits in 16, not packed, from 0 to 190:", ten.tolist())
assert ten.shape == (4, 5) and (ten != picture).mean() > 0.8, "10 bits: the behaviour has changed"
PY
