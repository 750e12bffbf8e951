#!/usr/bin/env bash
# A good guess: of an expression such as `first - second`, python-blosc2 gives the mean, the sum, the extremes and the standard deviation of one
# and the same array, that which `compute()` makes of it. Found: of whole numbers mean, sum and extremes are those of the array, whose
# values come round in their bits as NumPy's do, but std() and var() are of differences that do not: for two frames of 100 +- 5 in 8 bits
# std() is 7.1 and compute().std() 122. Noise of pairs of frames, measured in one line, changes 17-fold when it is written in two.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check blosc2==4.14.1 numpy==2.4.6
v/bin/python - <<'PY'
import blosc2
import numpy as np

random = np.random.default_rng(0)
results = []
for kind in (np.uint8, np.uint16):
    first, second = (random.normal(100, 5, (200, 200)).round().astype(kind) for _ in range(2))
    at_once = blosc2.asarray(first) - blosc2.asarray(second)
    array = at_once.compute()
    assert np.array_equal(array[:], first - second), "the array itself: the behaviour has changed"
    found = {name: (float(getattr(at_once, name)()), float(getattr(array, name)())) for name in ("mean", "sum", "max", "std", "var")}
    print("blosc2", blosc2.__version__, kind.__name__, "at once, of the array:", found)
    results.append((found, np.std(first - second.astype(float))))
agree = [abs(found[name][0] - found[name][1]) < 1e-6 * found[name][1] for found, _ in results for name in ("mean", "sum", "max")]
assert all(agree), "means: the behaviour has changed"
assert all(abs(found["std"][0] - noise) < 1e-6 for found, noise in results), "std: the behaviour has changed"
assert all(found["std"][1] > 15 * found["std"][0] for found, _ in results), "std of the array: the behaviour has changed"
assert all(found["var"][1] > 200 * found["var"][0] for found, _ in results), "var: the behaviour has changed"
PY
