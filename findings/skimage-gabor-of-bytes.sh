#!/usr/bin/env bash
# A good guess: scikit-image's `gabor` of an 8-bit picture is that of the same numbers as floats; both responses have a sign.
# Found: the responses are 8-bit numbers, too: -47.3 becomes 209, -29.2 becomes 227. Of plain stripes, whose strength is 50 everywhere,
# it is 206 on average and differs by 88 from pixel to pixel. 16 bits come round at 65536. The page says nothing of the kind of numbers.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check scikit-image==0.26.0 scipy==1.17.1 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from skimage.filters import gabor

columns = np.arange(64)
stripes = np.tile((128 + 100 * np.sin(2 * np.pi * 0.2 * columns)).round(), (64, 1))
inside = np.s_[20:44, 20:44]
found = {}
for kind in (np.float64, np.uint16, np.uint8):
    real, imaginary = gabor(stripes.astype(kind), 0.2)
    strength = np.hypot(real.astype(float), imaginary.astype(float))[inside]
    found[kind] = real[32, 28:33], strength.mean(), strength.std()
    print("scikit-image", version("scikit-image"), np.dtype(kind).name, "comes as", real.dtype, real[32, 28:33].round(1), end="; ")
    print(f"strength {strength.mean():.1f}, deviation {strength.std():.1f}")
right, mean, deviation = found[np.float64]
assert right.min() < -45 and 49 < mean < 51 and deviation < 0.5
assert np.array_equal(found[np.uint8][0], np.trunc(right).astype(int) % 256), "the behaviour has changed"
assert found[np.uint8][1] > 200 and found[np.uint8][2] > 80, "the behaviour has changed"
assert np.array_equal(found[np.uint16][0], np.trunc(right).astype(int) % 65536), "16 bits: the behaviour has changed"
PY
