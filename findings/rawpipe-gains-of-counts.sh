#!/usr/bin/env bash
# A good guess: rawpipe's wb() multiplies a raw picture of counts, from which its subtract() took black off, by gains of 1.9 for red and 1.5 for
# blue, or refuses counts as its demosaic() does. Found: it makes the gains numbers of the picture's kind first: 1.9 and 1.5 become 1, and the
# picture comes back as it was; gains of 2 wrap 40000 of 16 bits to 14464. As floats, the same picture is right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v
v/bin/pip install --quiet --disable-pip-version-check --no-deps rawpipe==0.19.3 numpy==2.4.6 opencv-python-headless==5.0.0.93
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import rawpipe

RED, GREEN, BLUE = 1.9, 1.0, 1.5
steps = rawpipe.Algorithms()
counts = steps.subtract(np.full((2, 2), 1064, np.uint16), [64, 64, 64, 64])
balanced = steps.wb(counts, [RED, GREEN, BLUE], "RGGB")
of_floats = steps.wb(counts.astype(np.float32), [RED, GREEN, BLUE], "RGGB")
doubled = steps.wb(np.full((1, 1, 3), 40000, np.uint16), [2.0, 2.0])
print("rawpipe", version("rawpipe"), "counts", counts.tolist(), "balanced", balanced.tolist(), "as floats", of_floats.tolist())
print("40000 by 2, 1 and 2:", doubled.reshape(-1).tolist())
assert counts.dtype == np.uint16 and np.all(counts == 1000), "black: the behaviour has changed"
assert np.array_equal(balanced, counts), "gains: the behaviour has changed"
assert np.allclose(of_floats, [[1900, 1000], [1000, 1500]]), "floats: the behaviour has changed"
assert doubled.reshape(-1).tolist() == [14464, 40000, 14464], "overflow: the behaviour has changed"
PY
