#!/usr/bin/env bash
# A good guess: `//` and `%` in a kernel of NVIDIA Warp are Python's, or both are C's; either way a = (a // b) b + a % b.
# Found: `//` rounds down as in Python, `%` keeps the sign of the first number as in C, of integers and of floats: -7 // 2 is
# -4 and -7 % 2 is -1, together -9. The usual wrap of an index or an angle, `i % n`, falls below zero, while `i // n` does not mind.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check numpy==2.4.6 warp-lang==1.19.0
cat >divide.py <<'PY'
import numpy as np
import warp as wp

wp.config.kernel_cache_dir = "cache"
wp.config.log_level = wp.LOG_WARNING


@wp.kernel
def divide(
    a: wp.array(dtype=int), b: wp.array(dtype=int), whole: wp.array(dtype=int), rest: wp.array(dtype=int), of_floats: wp.array(dtype=float)
):
    i = wp.tid()
    whole[i] = a[i] // b[i]
    rest[i] = a[i] % b[i]
    of_floats[i] = float(a[i]) % float(b[i])


a, b = np.int32([7, -7, 7, -7]), np.int32([2, 2, -2, -2])
outs = [wp.zeros(4, dtype=kind, device="cpu") for kind in (int, int, float)]
wp.launch(divide, 4, inputs=[wp.array(a, device="cpu"), wp.array(b, device="cpu"), *outs], device="cpu")
whole, rest, of_floats = (out.numpy() for out in outs)
print("warp-lang", wp.__version__, "-7 // 2 =", whole[1], " -7 % 2 =", rest[1], " together", 2 * whole[1] + rest[1])
assert whole.tolist() == [3, -4, -4, 3] and rest.tolist() == [1, -1, 1, -1] == of_floats.tolist(), "the behaviour has changed"
PY
v/bin/python divide.py
