#!/usr/bin/env bash
# A good guess: a boolean mask written by h5py is boolean in PyTables, and the other way round; both write and read booleans, and other kinds, half
# precision and complex numbers too, go across. Found: h5py's (an enumeration) is int8 in PyTables, PyTables' (a bit field) is uint8 in
# h5py. It looks right until it is used: ~mask is -1 and -2, or 255 and 254, so that the closed elements of a mask are all of them, and
# picture[mask] is no selection of pixels but rows 0 and 1, again and again.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check h5py==3.16.0 tables==3.11.1 numpy==2.4.6
v/bin/python - <<'PY'
import h5py
import numpy as np
import tables

mask = np.array([[True, False, False], [False, True, False]])
half = np.array([0.5, 1.5], np.float16)
with h5py.File("by-h5py.h5", "w") as file:
    file["mask"], file["half"] = mask, half
    assert file["mask"][:].dtype == bool
with tables.open_file("by-h5py.h5") as file:
    in_pytables, half_in_pytables = file.root.mask.read(), file.root.half.read()
with tables.open_file("by-pytables.h5", "w") as file:
    file.create_array("/", "mask", mask)
    assert file.root.mask.read().dtype == bool
with h5py.File("by-pytables.h5") as file:
    in_h5py = file["mask"][:]
picture = np.arange(6.0).reshape(2, 3)
print("h5py", h5py.__version__, "in PyTables", tables.__version__, in_pytables.dtype, "and back", in_h5py.dtype)
print("closed elements:", int((~mask).sum()), "become", int((~in_pytables != 0).sum()), int((~in_h5py != 0).sum()))
print("picture[mask]:", picture[mask].shape, "becomes", picture[in_pytables].shape, picture[in_h5py].shape)
assert half_in_pytables.dtype == np.float16 and np.array_equal(half_in_pytables, half), "half precision: the behaviour has changed"
assert in_pytables.dtype == np.int8 and in_h5py.dtype == np.uint8, "kinds: the behaviour has changed"
assert picture[in_pytables].shape == picture[in_h5py].shape == (2, 3, 3), "selections: the behaviour has changed"
PY
