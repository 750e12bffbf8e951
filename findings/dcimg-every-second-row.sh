#!/usr/bin/env bash
# A good guess: dcimg gives any part of a Hamamatsu film that NumPy's slices name, and puts back the four pixels of row 1023 that the camera's software stores
# behind each frame. Found: every second row from 0 on has row 1022, and that gets row 1023's four pixels; all rows before 1023, and row 1022
# alone, are an IndexError. With NumPy 2, frames counted from the end, as on its own page, are an OverflowError, and from 2.4 on no film opens.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps dcimg==0.6.0.post1 numpy==2.3.5
v/bin/python -W ignore - <<'PY'
import struct
from importlib.metadata import version
from pathlib import Path

import numpy as np
from dcimg import DCIMGFile

ROWS, COLUMNS, FRAMES, HEAD, SESSION = 2048, 16, 2, 232, 760
picture = np.repeat(np.arange(ROWS, dtype="<u2")[:, None], COLUMNS, 1)  # each row holds its number
head, session = bytearray(HEAD), bytearray(SESSION)
head[:5] = b"DCIMG"
struct.pack_into("<I", head, 8, 0x1000000)  # the newer of two formats
struct.pack_into("<3I", head, 0x20, 1, FRAMES, HEAD)
struct.pack_into("<7I", session, 60, FRAMES, 2, 0, COLUMNS, ROWS, 2 * COLUMNS, 2 * COLUMNS * ROWS)
struct.pack_into("<Q", session, 96, SESSION)
struct.pack_into("<4H", session, 712, 0, COLUMNS, 0, ROWS)
stored = picture.copy()
stored[1023, :4] = 0
frames = [stored.tobytes() + struct.pack("<3I", number, 1000, 0) + picture[1023, :4].tobytes() + bytes(12) for number in range(FRAMES)]
Path("film.dcimg").write_bytes(head + session + b"".join(frames))

film = DCIMGFile("film.dcimg")
assert (film[:] == picture).all() and (film[0, 1::2] == picture[1::2]).all() and (film[0, 1000:1100] == picture[1000:1100]).all()
second = film[0, ::2]
wrong = np.argwhere(second != picture[::2]).tolist()
print("dcimg", version("dcimg"), "of every second row, wrong at", wrong, "values", second[511, :6].tolist(), "where all are 1022")
assert wrong == [[511, column] for column in range(4)] and second[511, 0] == 1023, "every second row: the behaviour has changed"
refused = {}
for name, part in {"rows before 1023": np.s_[0, :1023], "row 1022": np.s_[0, 1022], "the last frame": np.s_[-1]}.items():
    try:
        film[part]
    except (IndexError, OverflowError) as error:
        refused[name] = type(error).__name__
print("refused, with NumPy", np.__version__, refused)
assert refused == {"rows before 1023": "IndexError", "row 1022": "IndexError", "the last frame": "OverflowError"}, "parts: the behaviour has changed"
PY
