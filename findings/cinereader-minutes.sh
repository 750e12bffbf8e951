#!/usr/bin/env bash
# A good guess: cinereader, which reads the films of Phantom cameras, gives the time of each picture after the trigger. Found: it subtracts the seconds within
# the minute: a picture 10 ms after a trigger at 59.995 s is at -59.99 s, in microseconds. Asked for some pictures it gives the times
# of all, from the film's first one on, so that they do not go together; films that do not begin at the trigger it reads only with the
# first number given, and films of 14 bits not at all.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --disable-pip-version-check --no-compile --no-deps cinereader==1.4.3 numpy==2.4.6 numba==0.68.1 llvmlite==0.50.0 pandas==2.3.3 python-dateutil==2.9.0.post0 pytz==2025.2 tzdata==2025.2 six==1.17.0
NUMBA_NUM_THREADS=1 v/bin/python - <<'PY'
import struct
from importlib.metadata import version
from pathlib import Path

import cinereader
import numpy as np

SETUP, FIRST, MINUTE = 10688, -2, 1_700_000_040  # a full minute of UTC, in seconds


def write(name, seconds, trigger, bits):
    """Write four pictures of 2 x 4 pixels, of values 1 to 4, with a block of times (1002) behind the settings."""
    setup, begin, fixed = bytearray(SETUP), 84, lambda time: int(time) << 32 | round(time % 1 * 2**32)
    times = struct.pack("<IHH", 8 + 8 * 4, 1002, 0) + struct.pack("<4Q", *map(fixed, seconds))
    offsets = begin + SETUP + len(times)
    struct.pack_into("<2sH", setup, 140, b"ST", SETUP)
    struct.pack_into("<HH", setup, 737, 4, 2)
    struct.pack_into("<I", setup, 896, bits)
    struct.pack_into("<f", setup, 10388, 1.0)
    struct.pack_into("<d", setup, 10400, 100.0)
    head = struct.pack("<2sHHHiIiIIIIQ", b"CI", 44, 0, 1, FIRST, 4, FIRST, 4, 44, begin, offsets, fixed(trigger))
    bitmap = struct.pack("<IiiHHIIiiII", 40, 4, 2, 1, 16, 0, 16, 0, 0, 0, 0)
    data = [struct.pack("<II", 8, 16) + np.full(8, value, "<u2").tobytes() for value in (1, 2, 3, 4)]
    table = struct.pack("<4q", *(offsets + 32 + 24 * number for number in range(4)))
    Path(name).write_bytes(head + bitmap + setup + times + table + b"".join(data))


found = {}
for trigger in (MINUTE + 30, MINUTE + 59.995):
    write("film.cine", [trigger + 0.01 * number for number in (-2, -1, 0, 1)], trigger, 12)
    metadata = cinereader.read_metadata("film.cine")
    found[trigger - MINUTE] = (cinereader.read_time_from_trigger(metadata, "film.cine") / 1e6).round(4).tolist()
print("cinereader", version("cinereader"), "seconds after triggers at 30 and 59.995 s of a minute:", found)
assert list(found.values()) == [[-0.02, -0.01, 0, 0.01], [-0.02, -0.01, 0, -59.99]], "times: the behaviour has changed"

_, pictures, times = cinereader.read("film.cine", 0, 2)
print("asked for the trigger's picture and the next, values", [int(picture[0, 0]) for picture in pictures], "with times", (times / 1e6).round(4).tolist())
assert [int(picture[0, 0]) for picture in pictures] == [3, 4] and len(times) == 4, "parts: the behaviour has changed"
refused = []
try:
    cinereader.read("film.cine")
except Exception as error:
    refused.append(type(error).__name__)
write("film.cine", [MINUTE + 30] * 4, MINUTE + 30, 14)
try:
    cinereader.read("film.cine", FIRST, 4)
except KeyError as error:
    refused.append(f"KeyError {error}")
print("the whole film, with no number given, and 14 bits:", refused)
assert len(refused) == 2 and refused[1] == "KeyError 14", "refusals: the behaviour has changed"
PY
