#!/usr/bin/env bash
# A good guess: mat73 gives MATLAB's arrays (v7.3) with MATLAB's shapes. Found: of three and more axes it does, ones included; a row and a column
# both become a flat array, so that which of the two it was is lost (hdf5storage keeps it), and an array without elements, 0 x 3,
# becomes None.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check mat73==0.65 hdf5storage==0.2.2 h5py==3.15.1 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import hdf5storage
import mat73
import numpy as np

arrays = {"row": np.ones((1, 5)), "column": np.ones((5, 1)), "deep": np.ones((1, 1, 4)), "none": np.zeros((0, 3))}
hdf5storage.savemat("x.mat", dict(arrays), format="7.3", store_python_metadata=False)
kept = {name: array.shape for name, array in hdf5storage.loadmat("x.mat").items() if name in arrays}
found = {name: getattr(array, "shape", None) for name, array in mat73.loadmat("x.mat").items()}
print("mat73", version("mat73"), found, "hdf5storage", version("hdf5storage"), kept)
assert kept == {name: array.shape for name, array in arrays.items()}, "the behaviour has changed"
assert found == {"row": (5,), "column": (5,), "deep": (1, 1, 4), "none": None}, "the behaviour has changed"
PY
