#!/usr/bin/env bash
# A good guess: sums and means by Bottleneck (which xarray and pandas use where it is installed) and in Numba's functions are NumPy's,
# only faster: NumPy adds in pairs, and loses nothing that matters in single precision. Found: both add one value after the other in the
# array's own type. The mean of 20 million pixels of 1 is 0.839, their variance 0.026; Bottleneck's moving mean of float32
# stays off behind one bright reading, its sum of int32 wraps where NumPy takes 64 bits. Numba's nanmean and float64 are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check bottleneck==1.6.0 numba==0.68.1 numpy==2.4.6
v/bin/python - <<'PY'
import bottleneck
import numba
import numpy as np

white = np.ones(20_000_000, np.float32)


@numba.njit
def statistics(values):
    return values.mean(), values.var(), np.nanmean(values)


mean = {
    "NumPy": (white.mean(), white.var()),
    "Bottleneck": (bottleneck.nanmean(white), bottleneck.nanvar(white)),
    "Numba": statistics(white)[:2],
}
mean = {name: [round(float(value), 3) for value in pair] for name, pair in mean.items()}
readings = np.full(1000, 1000, np.float32)
readings[10] = 1e9
window = bottleneck.move_mean(readings, 5)[100:]
counts = np.full(70_000, 60_000, np.int32)
total = int(bottleneck.nansum(counts)), int(counts.sum())
print("bottleneck", bottleneck.__version__, "numba", numba.__version__, "mean and variance of ones", mean)
print("moving means of 1000 after one 1e9", np.unique(window), "sum of int32", total, "Numba's nanmean", statistics(white)[2])
assert mean["NumPy"] == [1.0, 0.0] and statistics(white)[2] == 1, "what is right has changed"
assert mean["Bottleneck"][0] == mean["Numba"][0] == 0.839, "means: the behaviour has changed"
assert 0.02 < mean["Bottleneck"][1] < 0.03 and 0.02 < mean["Numba"][1] < 0.03, "variances: the behaviour has changed"
assert bottleneck.nanmean(white.astype(float)) == statistics(white.astype(float))[0] == 1, "float64 has changed"
assert abs(window - 1000).min() > 1, "moving means: the behaviour has changed"
assert total == (4_200_000_000 - 2**32, 4_200_000_000), "sums of int32: the behaviour has changed"
PY
