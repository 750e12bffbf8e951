#!/usr/bin/env bash
# A good guess: pyfive, which reads HDF5 in Python alone, reads a virtual dataset (how detectors join files of one scan) or says that
# it cannot, and gives boolean masks by h5py as booleans. Found: every read of a virtual dataset is None, with its right shape and
# type and no word; a dataset of which a chunk was never written raises a KeyError instead of its fill value; booleans are
# signed bytes, so that picture[mask] takes rows 0 and 1, and ~mask is -1 and -2.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pyfive==1.3.0 h5py==3.16.0 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import h5py
import numpy as np
import pyfive

with h5py.File("scan.h5", "w") as file:
    layout = h5py.VirtualLayout((2, 3), "int64")
    for row in range(2):
        file[f"frame{row}"] = np.arange(3) + 10 * row
        layout[row] = h5py.VirtualSource(file[f"frame{row}"])
    file.create_virtual_dataset("frames", layout)
    part = file.create_dataset("part", (4, 5), chunks=(2, 5), dtype="float32", fillvalue=7)
    part[:2] = 1
    file["mask"] = np.array([[True, False], [False, True]])

with h5py.File("scan.h5") as file:
    by_h5py = file["frames"][()].tolist()
file = pyfive.File("scan.h5")
frames, mask = file["frames"], file["mask"][()]
try:
    part = file["part"][()].tolist()
except KeyError:
    part = "KeyError"
picture = np.array([[1, 2], [3, 4]])
print("pyfive", version("pyfive"), "virtual dataset of shape", frames.shape, frames.dtype, "is", frames[()], "by h5py", by_h5py)
print("a chunk that was never written:", part, "mask", mask.dtype, "picture[mask]", picture[mask].tolist(), "~mask", (~mask).tolist())
assert frames.shape == (2, 3) and frames[()] is None and by_h5py == [[0, 1, 2], [10, 11, 12]], "what virtual datasets are has changed"
assert part == "KeyError", "what unwritten chunks are has changed"
assert mask.dtype == np.int8 and picture[mask].shape == (2, 2, 2), "what booleans are has changed"
PY
