#!/usr/bin/env bash
# A good guess: dask-image's filters give what SciPy's of the same names give, whatever the chunks, with mode="wrap", too, by which the last row lies
# above the first. Found: with "wrap" each border is taken from its own chunk: above row 0 of 64 rows in two chunks lies row 32, the end of the
# first chunk's overlap, so that the mean of three is 11 instead of 21.3. Of four chunks a Gaussian filter of 2 changes 44 % of the pixels, Sobel's
# the first row by up to 2.1. In one chunk all agree, and in four with "reflect", "nearest", "mirror" and "constant".
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check dask-image==2026.5.0 dask==2026.8.0 numpy==2.4.6 scipy==1.17.1
v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import dask.array as da
import numpy as np
from dask_image import ndfilters
from scipy import ndimage

picture = np.random.default_rng(0).random((64, 64))
filters = {"gaussian_filter": (2,), "uniform_filter": (5,), "median_filter": (5,), "sobel": ()}


def beside(name, mode, chunk):
    """Return by how much the result differs from SciPy's at most, and in which part of the pixels."""
    there = getattr(ndimage, name)(picture, *filters[name], mode=mode)
    here = getattr(ndfilters, name)(da.from_array(picture, chunks=chunk), *filters[name], mode=mode).compute(scheduler="sync")
    return round(float(abs(here - there).max()), 3), round(float((abs(here - there) > 1e-9).mean()), 3)


found = {name: beside(name, "wrap", 32) for name in filters}
print("dask-image", version("dask-image"), "wrap, four chunks: largest difference, part of the pixels", found)
assert all(largest > 0.05 for largest, _ in found.values()), "wrap: the behaviour has changed"
assert found["gaussian_filter"][1] == 0.438, "wrap: the behaviour has changed"
assert all(beside(name, "wrap", 64)[0] == 0 for name in filters), "one chunk: the behaviour has changed"
others = [beside(name, mode, 32)[0] for name in filters for mode in ("reflect", "nearest", "mirror", "constant")]
assert max(others) == 0, "other modes: the behaviour has changed"
rows = np.arange(64.0)[:, None] * np.ones((1, 64))
top = ndfilters.uniform_filter(da.from_array(rows, chunks=32), (3, 1), mode="wrap")[0, 0].compute(scheduler="sync")
print("mean of rows 63, 0 and 1:", round(64 / 3, 2), "found", round(float(top), 2))
assert round(float(top), 2) != round(64 / 3, 2), "the first row: the behaviour has changed"
PY
