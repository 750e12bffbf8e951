#!/usr/bin/env bash
# A good guess: pyMRAW's load_images(), which by its page "loads the next N images" of a film of Photron's cameras, goes through a film part by part; its
# save_mraw() keeps the values, or refuses what 16 bits do not hold, as it does what is too large. Found: each call gives the first N
# images again, whatever was read or sought, and 12 bits only as a whole film. And save_mraw() wraps what is below zero (-5, as after a dark
# frame is taken off, is 65531) and cuts fractions, so that pictures between 0 and 1 are black.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check --no-deps pymraw==0.33.0 numpy==2.4.6 numba==0.68.1 llvmlite==0.50.0 xmltodict==1.0.4
NUMBA_NUM_THREADS=1 v/bin/python - "$folder" <<'PY'
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pyMRAW

folder = Path(sys.argv[1])
assert "loads the next N images" in pyMRAW.load_images.__doc__, "the behaviour has changed"
film = np.arange(6)[:, None, None] * 100 + np.zeros((1, 2, 4), int)
name, header = pyMRAW.save_mraw(film, str(folder / "film.cih"))
with open(name, "rb") as file:
    parts = [pyMRAW.load_images(file, 2, 4, 2, roll_axis=False)[:, 0, 0].tolist() for _ in range(2)]
    file.seek(4 * 2 * 4 * 2)
    sought = pyMRAW.load_images(file, 2, 4, 2, roll_axis=False)[:, 0, 0].tolist()
print("pyMRAW", version("pymraw"), "two images, the next two, and those from the fifth on, of 0, 100 to 500:", *parts, sought)
assert parts == [[0, 100], [0, 100]] and sought == [0, 100], "parts: the behaviour has changed"
whole, _ = pyMRAW.load_video(header)
assert whole[:, 0, 0].tolist() == [0, 100, 200, 300, 400, 500], "whole films: the behaviour has changed"

packed = bytes(byte for one, other in film.reshape(-1, 2) for byte in (one >> 4, (one & 15) << 4 | other >> 8, other & 255))
(folder / "packed.mraw").write_bytes(packed)
with open(folder / "packed.mraw", "rb") as file:
    try:
        part = pyMRAW.load_images(file, 2, 4, 2, bit=12)
    except ValueError as error:
        part = str(error)
print("two images of twelve bits:", part)
assert "cannot reshape" in part, "twelve bits: the behaviour has changed"

kept = {}
for values in ((-5, 7), (0.5, 0.9)):
    _, header = pyMRAW.save_mraw(np.array([[values]]), str(folder / "few.cih"))
    kept[values] = np.asarray(pyMRAW.load_video(header)[0]).ravel().tolist()
try:
    pyMRAW.save_mraw(np.array([[[70000]]]), str(folder / "few.cih"))
    kept[70000] = "saved"
except ValueError:
    kept[70000] = "refused"
print("saved and read:", kept)
assert kept == {(-5, 7): [65531, 7], (0.5, 0.9): [0, 0], 70000: "refused"}, "values: the behaviour has changed"
PY
