#!/usr/bin/env bash
# A good guess: a centroid by aotools of a camera's counts is that of the same counts as floating numbers, and of a frame alone that of the frame in
# a stack. Found: brightest_pixel() subtracts its level within the counts' own type, so that in unsigned ones what is darker comes round to
# 65,535 and more: a spot at column 20.3 is found in the middle of the frame. centre_of_gravity() with a threshold takes the level off what
# is left of one frame, and leaves it on in a stack (a twentieth to a tenth of a pixel here), whose dark pixels it sets to 0 in the
# caller's own array. Convert to float, copy, and give one frame at a time.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check aotools==1.0.8 numpy==2.4.6 scipy==1.17.1
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from aotools.image_processing import brightest_pixel, centre_of_gravity

rows, columns = np.indices((32, 32))
spot = 1000 * np.exp(-((columns - 20.3) ** 2 + (rows - 9.6) ** 2) / 8) + 100 + 30 * np.sin(columns)
found = {}
for kind in (np.float64, np.int32, np.uint16):
    column, row = brightest_pixel(spot.astype(kind), 0.05)
    found[kind] = float(column), float(row)
    print(f"aotools {version('aotools')} brightest_pixel, {kind.__name__}: column {column:.2f}, row {row:.2f} (true 20.30, 9.60)")
alone = centre_of_gravity(spot.copy(), threshold=0.3)
stack = spot.copy()[None]
in_stack = centre_of_gravity(stack, threshold=0.3)[:, 0]
changed = float((stack[0] != spot).mean())
print(f"centre of gravity, threshold 0.3: alone {alone.round(3)}, in a stack {in_stack.round(3)}; changed {changed:.0%} of the caller's stack")
assert np.allclose(found[np.float64], (20.3, 9.6), atol=0.02) and np.allclose(found[np.int32], found[np.float64], atol=0.01)
assert found[np.uint16][0] < 16 and found[np.uint16][1] > 15, "unsigned counts: the behaviour has changed"
assert np.all(np.abs(alone - in_stack) > 0.04), "the behaviour has changed"
assert changed > 0.9, "the caller's stack: the behaviour has changed"
PY
