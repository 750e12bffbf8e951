#!/usr/bin/env bash
# A good guess: dask-image's affine_transform takes the matrix as SciPy's does, so that one factor for each axis, [1, 1] or [0.5, 0.5], is the
# diagonal matrix of them, in chunks as in one piece. Found: with more than one output chunk, the factors' products with a chunk's place are
# added up and moved along every axis: by [1, 1], which changes nothing, all but the first chunk show another part of the picture, or nothing.
# The same factors as a matrix of 2 x 2 are right, and output chunks are one piece unless told, so a small test is right, too.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check dask-image==2026.5.0 dask==2026.8.0 numpy==2.4.6 scipy==1.17.1
v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import dask.array as da
import numpy as np
from dask_image.ndinterp import affine_transform
from scipy import ndimage

picture = np.add.outer(100 * np.arange(64.0), np.arange(80.0))
found = {}
for name, factors in (("[1, 1]", [1, 1]), ("[0.5, 0.5]", [0.5, 0.5])):
    right = ndimage.affine_transform(picture, np.array(factors), order=1)
    for form, matrix in (("factors", np.array(factors)), ("matrix", np.diag(factors))):
        for chunks in (None, (32, 40)):
            got = affine_transform(da.from_array(picture, chunks=(32, 40)), matrix, order=1, output_chunks=chunks).compute()
            found[name, form, chunks] = float(np.mean(np.abs(got - right) > 0.5))
            print(f"dask-image {version('dask-image')} {name} as {form}, output chunks {chunks}: {found[name, form, chunks]:.0%} of the pixels wrong")
assert all(wrong > 0.5 for (_, form, chunks), wrong in found.items() if form == "factors" and chunks), "the behaviour has changed"
assert all(wrong == 0 for (_, form, chunks), wrong in found.items() if form == "matrix" or not chunks), "another form is wrong"
PY
