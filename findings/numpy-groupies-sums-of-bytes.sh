#!/usr/bin/env bash
# A good guess: numpy-groupies sums the values of each group as NumPy does, "nansum" without NaN, and for pictures of whole numbers, which have none,
# the two are one. Found: "sum" picks a type that holds the result, "nansum" and "cumsum" stay in that of the picture: 100,000 pixels of 100
# make 128 in 8 bits and 38,528 in 16, of a boolean mask with 100,000 open elements True. "nanmean" and "nansumofsquares" are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check numpy-groupies==0.16.0 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import numpy_groupies

group = np.zeros(100_000, int)
found = {}
for kind, level in ((np.uint8, 100), (np.uint16, 100), (bool, 1), (np.float32, 100)):
    picture = np.full(group.size, level).astype(kind)
    sums = {func: numpy_groupies.aggregate_np(group, picture, func=func)[-1].item() for func in ("sum", "nansum", "cumsum", "nanmean")}
    print("numpy-groupies", version("numpy-groupies"), kind.__name__, "NumPy's nansum", np.nansum(picture), sums)
    assert sums["sum"] == level * group.size and sums["nanmean"] == level, "sum or nanmean: the behaviour has changed"
    found[kind] = sums["nansum"], sums["cumsum"]
assert found == {np.uint8: (128, 128), np.uint16: (38_528, 38_528), bool: (True, True), np.float32: (1e7, 1e7)}, "the behaviour has changed"
PY
