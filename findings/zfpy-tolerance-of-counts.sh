#!/usr/bin/env bash
# A good guess: zfpy.compress_numpy(picture, tolerance=0.5) keeps every value within 0.5 of what it was, whatever the array's type, and
# precision=16 keeps 12-bit counts without loss. Found: both hold for floating numbers. Of int32 and int64 the tolerance is ignored with no word:
# 0.5 and 1000 give the same counts, off by up to 8; the precision is counted from the top of the type, so that counts of
# 12 bits in int32 all become 0. Lossless (no parameter) is right; for a bound, convert to float first.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check zfpy==1.0.1.post0 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import zfpy

rows, columns = np.indices((64, 64))
counts = (2000 + 1000 * np.sin(rows / 9) * np.cos(columns / 7) + np.random.default_rng(0).normal(0, 30, rows.shape)).round()
found = {}
for kind in (np.int32, np.int64, np.float32, np.float64):
    picture = counts.astype(kind)
    packed = {}
    for name, value in (("tolerance", 0.5), ("tolerance", 1000), ("precision", 16), ("none", None)):
        data = zfpy.compress_numpy(picture, **({} if value is None else {name: value}))
        packed[name, value] = zfpy.decompress_numpy(data)
        off = float(np.abs(packed[name, value].astype(float) - counts).max())
        found[kind, name, value] = off
        print(f"zfpy {version('zfpy')} {kind.__name__} {name} {value}: off by up to {off:g}, {len(data)} of {picture.nbytes} bytes")
    found[kind, "same"] = np.array_equal(packed["tolerance", 0.5], packed["tolerance", 1000])
whole, floating = (np.int32, np.int64), (np.float32, np.float64)
assert all(found[kind, "tolerance", 0.5] > 2 and found[kind, "same"] for kind in whole), "tolerance: the behaviour has changed"
assert all(found[kind, "precision", 16] == counts.max() for kind in whole), "precision: the behaviour has changed"
assert all(found[kind, "tolerance", 0.5] <= 0.5 and not found[kind, "same"] and found[kind, "precision", 16] <= 2 for kind in floating)
assert all(found[kind, "none", None] == 0 for kind in (*whole, *floating)), "lossless is not"
PY
