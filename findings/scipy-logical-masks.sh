#!/usr/bin/env bash
# A good guess: a logical array of a .mat file comes from scipy.io.loadmat as a NumPy array of bool, as it went in.
# Found: it comes as uint8, unless mat_dtype=True. So ~mask is 254 and 255, an inverted mask that is closed nowhere; and
# values[mask] takes rows 0 and 1 again and again instead of the values under the mask. whosmat calls the same array
# logical. No warning.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder"/venv/bin/pip install --quiet scipy==1.17.1 numpy==2.4.6
cd "$folder"
venv/bin/python - <<'PY'
import sys

import numpy as np
import scipy
from scipy import io

print("scipy", scipy.__version__, "numpy", np.__version__)
mask = np.random.default_rng(0).random((6, 8)) < 0.5
values = np.arange(48.0).reshape(6, 8)
io.savemat("mask.mat", {"mask": mask})
print("whosmat:", io.whosmat("mask.mat"))
read = io.loadmat("mask.mat")["mask"]
exact = io.loadmat("mask.mat", mat_dtype=True)["mask"]
print("loadmat:", read.dtype, "with mat_dtype:", exact.dtype)
print("open share of the mask:", mask.mean(), "of ~mask:", (~read).mean(), "elements of ~mask that are closed:", (~read == 0).sum())
print("values[mask] by bool:", values[mask].shape, "as loaded:", values[read].shape)
same = read.dtype == np.uint8 and exact.dtype == bool and io.whosmat("mask.mat")[0][2] == "logical"
if not (same and (~read).min() == 254 and values[read].shape == (6, 8, 8)):
    sys.exit("the behaviour has changed")
PY
