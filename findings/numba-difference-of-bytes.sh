#!/usr/bin/env bash
# A good guess: in a function compiled by Numba the difference of two bytes, 100 - 200, is what NumPy has, 156, or what C has, -100.
# Found: unsigned numbers become unsigned ones of 64 bits: it is 18446744073709551516, abs() leaves it so, its square is out by as much,
# and a sum of absolute differences of two pictures, or a dark frame taken off, is 1e19. The sign of one byte alone is taken in
# 8 bits (-200 is 56), arrays are subtracted in 8 bits (156), and bytes minus a literal are signed (-100).
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check numba==0.68.1 numpy==2.4.6
v/bin/python - <<'PY'
import numba
import numpy as np


@numba.njit
def differences(a, b):
    return a[0] - b[0], abs(a[0] - b[0]), -b[0], a[0] - 200


@numba.njit
def sum_of_differences(a, b):
    total = 0.0
    for i in range(len(a)):
        total += abs(a[i] - b[i])
    return total


@numba.njit
def arrays(a, b):
    return a - b


seen = {}
for kind in (np.uint8, np.uint16):
    a, b = np.array([100, 50, 7], kind), np.array([200, 40, 7], kind)
    seen[kind.__name__] = [int(value) for value in differences(a, b)], float(sum_of_differences(a, b)), int(arrays(a, b)[0])
a, b = np.array([100, 50, 7], np.int16), np.array([200, 40, 7], np.int16)
signed = differences(a, b)[0], sum_of_differences(a, b)
print("numba", numba.__version__, "a - b, |a - b|, -b, a - 200; sum of |a - b|; arrays", seen, "signed", signed)
for kind, bits in (("uint8", 8), ("uint16", 16)):
    one, total, of_arrays = seen[kind]
    assert one == [2**64 - 100] * 2 + [2**bits - 200, -100], "numbers: the behaviour has changed"
    assert total > 1e19 and of_arrays == 2**bits - 100, "sums and arrays: the behaviour has changed"
assert signed == (-100, 110), "signed numbers: the behaviour has changed"
PY
