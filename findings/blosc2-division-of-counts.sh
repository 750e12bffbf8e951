#!/usr/bin/env bash
# A good guess: compressed arrays of python-blosc2 divide as NumPy's do: counts over a flat field are fractions.
# Found: a quotient of two stored arrays of whole numbers is cut to a whole number and then called float64 (of int32, float32): 1000 / 1500
# is 0, and the mean over a picture with it; by `/`, by a text, by blosc2.divide and by np.divide, 8 to 64 bits. With a dark level taken off
# first, (raw - 10) / (flat - 10), or over a plain number, it is right. Its `%` has the sign of what is divided, also of floats: -5 % 3 is -2.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check blosc2==4.14.1 numpy==2.4.6
v/bin/python - <<'PY'
import blosc2
import numpy as np

counts, white = [1000, 2000, 3000, 5000], [1500, 2500, 3500, 3000]
for kind in (np.uint16, np.int32, np.int64):
    raw, flat = np.array(counts, kind), np.array(white, kind)
    stored = {"raw": blosc2.asarray(raw), "flat": blosc2.asarray(flat)}
    ways = {
        "/": stored["raw"] / stored["flat"],
        "text": blosc2.lazyexpr("raw / flat", stored),
        "divide": blosc2.divide(stored["raw"], stored["flat"]),
        "np.divide": np.divide(stored["raw"], stored["flat"]),
    }
    quotients = {way: expression[:] for way, expression in ways.items()}
    without_dark = ((stored["raw"] - 10) / (stored["flat"] - 10))[:]
    print("blosc2", blosc2.__version__, kind.__name__, "NumPy", (raw / flat).round(3), "blosc2", quotients, "dark off", without_dark.round(3))
    assert all((found == [0, 0, 0, 1]).all() and found.dtype.kind == "f" for found in quotients.values()), "the behaviour has changed"
    assert float(ways["/"].mean()) == 0.25, "means: the behaviour has changed"
    assert np.allclose(without_dark, (raw - 10) / (flat - 10)), "with the dark level taken off: the behaviour has changed"
    assert np.allclose((stored["raw"] / 1500)[:], raw / 1500), "over a number: the behaviour has changed"
signed = np.array([-5.0, -4.0, 5.0])
remainders = (blosc2.asarray(signed) % 3)[:]
print("remainders of -5, -4 and 5 by 3", remainders, "NumPy", signed % 3)
assert remainders.tolist() == [-2, -1, 2], "remainders: the behaviour has changed"
PY
