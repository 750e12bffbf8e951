#!/usr/bin/env bash
# A good guess: numcodecs' FixedScaleOffset, by which Zarr stores counts in coarser steps, moves each count to the next step: 16-bit counts by twos come back
# off by one at most. Found: 65535, a saturated pixel, comes back as 0, since its step is 65536. And counts beside the steps that bytes hold
# come round: with an offset of 1000, 900 is 1156 and 1300 is 1044; differences of 8 bits make 65525 of 501 after 1. All without a
# word. And BitRound makes the largest floats infinite.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check numcodecs==0.16.6 numpy==2.4.6
v/bin/python -W error - <<'PY'
from importlib.metadata import version

import numcodecs
import numpy as np


def back(codec, values, kind):
    return np.asarray(codec.decode(codec.encode(np.array(values, kind)))).view(kind).tolist()


print("numcodecs", version("numcodecs"))
twos = numcodecs.FixedScaleOffset(offset=0, scale=0.5, dtype="u2", astype="u2")
counts = np.arange(65536)
off = np.abs(np.array(back(twos, counts, "u2")) - counts)
saturated = back(twos, [65533, 65534, 65535], "u2")
print("counts by twos: off by more than one at", np.flatnonzero(off > 1), "65533 to 65535 come back as", saturated)
assert np.flatnonzero(off > 1).tolist() == [65535] and saturated[2] == 0, "steps: the behaviour has changed"

from_1000 = numcodecs.FixedScaleOffset(offset=1000, scale=1, dtype="u2", astype="u1")
beside = back(from_1000, [900, 1000, 1255, 1300], "u2")
print("900, 1000, 1255 and 1300 from 1000 on in bytes:", beside)
assert beside == [1156, 1000, 1255, 1044], "offsets: the behaviour has changed"

steps = back(numcodecs.Delta(dtype="u2", astype="i1"), [1, 501, 502, 1], "u2")
print("1, 501, 502 and 1 by differences of 8 bits:", steps)
assert steps[0] == 1 and steps[1] != 501 and steps[2] != 502, "differences: the behaviour has changed"

rounded = back(numcodecs.BitRound(keepbits=3), [3.4e38, 1.0], "f4")
print("3.4e38 and 1 with three bits:", rounded)
assert rounded == [float("inf"), 1.0], "bits: the behaviour has changed"
PY
