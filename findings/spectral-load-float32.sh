#!/usr/bin/env bash
# A good guess: SPy's `load()` reads an ENVI cube as what its header says it holds, as slices of the opened image and its memory map do.
# Found: everything becomes single precision, 32-bit counts and float64 too: counts from 16.8 million on are changed in their last digits
# (3,932,100,007 becomes 3,932,100,096), and wavelengths' reflectance loses half its digits, while `image[:, :, :]` of the same file keeps
# all. `load(dtype=...)` says what is wanted.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check spectral==0.25 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from spectral.io import envi

cube = np.full((2, 3, 4), 3_932_100_007, np.uint32)
envi.save_image("counts.hdr", cube)
image = envi.open("counts.hdr")
loaded, sliced = image.load(), image[:, :, :]
print("spectral", version("spectral"), image.dtype, "loaded as", loaded.dtype, int(loaded[0, 0, 0]), "sliced as", sliced.dtype, sliced[0, 0, 0])
assert loaded.dtype == np.float32 and int(loaded[0, 0, 0]) == 3_932_100_096, "the behaviour has changed"
assert sliced.dtype == np.uint32 and np.array_equal(sliced, cube), "the behaviour has changed"
assert np.array_equal(np.asarray(image.load(dtype=np.uint32)), cube), "the behaviour has changed"
PY
