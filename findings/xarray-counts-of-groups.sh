#!/usr/bin/env bash
# A good guess: groupby(...).count() of an xarray of camera counts is the number of pixels in each group, whichever of its optional packages are
# there. Found: with flox and numbagg installed, which xarray then takes by itself, count() has the type of the pictures: 50,000 pixels of 8
# bits are 80, of 16 bits with a sign -15,536, and right without a sign until 65,535. Sums, means and deviations are right. flox's own nansum
# of whole numbers comes round likewise: 2,525,000 is 72. A mean by sum / count is then 625 times too large, with no word.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check xarray==2026.9.0 flox==0.11.2 numbagg==0.9.6 numba==0.68.1 numpy==2.4.6
v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import flox
import numpy as np
import xarray as xr

group = np.repeat([0, 1], 50_000)
found = {}
for kind in (np.uint8, np.int16, np.uint16, np.int64, np.float32):
    pixels = np.full(group.size, 100).astype(kind)
    pixels[::2] = 1
    pictures = xr.DataArray(pixels, dims="pixel", coords={"group": ("pixel", group)})
    counts = {}
    for used in (True, False):
        with xr.set_options(use_flox=used):
            by = pictures.groupby("group")
            counts[used] = int(by.count()[0])
            assert int(by.sum()[0]) == 2_525_000 and float(by.mean()[0]) == 50.5, "sum or mean"
    total = int(flox.groupby_reduce(pixels, group, func="nansum")[0][0])
    found[kind] = counts[True], counts[False], total
    print(f"xarray {version('xarray')}, flox {version('flox')}, numbagg {version('numbagg')} {kind.__name__}: count {counts[True]}, without flox {counts[False]}; flox's nansum {total}")
assert all(found[kind][1] == 50_000 for kind in found)
assert found[np.int64] == found[np.float32] == (50_000, 50_000, 2_525_000)
assert found[np.uint8][0] == 80 and found[np.int16][0] == -15_536 and found[np.uint16][0] == 50_000, "count: the behaviour has changed"
assert found[np.uint8][2] == 72, "nansum: the behaviour has changed"
PY
