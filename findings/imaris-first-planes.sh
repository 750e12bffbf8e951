#!/usr/bin/env bash
# A good guess: imaris-ims-file-reader gives the parts of an Imaris file that NumPy's slices name: the first five planes for :5, the last one for -1.
# Found: a slice with an end alone is taken for a number: :5 is the sixth plane, the same as 5, and :5:1 the fifth; of -1 nothing comes,
# without a word. 0:5 and 3: are right. Beside it: voxels are rounded to three decimals, 62.5 nm to 62 nm.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps imaris-ims-file-reader==0.1.8 numpy==2.4.6 h5py==3.14.0
mkdir skimage  # which it imports for saving pictures, and not for reading
echo "io = img_as_float32 = img_as_uint = img_as_ubyte = None" > skimage/__init__.py
echo "rescale = None" > skimage/transform.py
PYTHONPATH=. v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import h5py
import numpy as np
from imaris_ims_file_reader import ims

PLANES, ROWS, COLUMNS = 8, 4, 16
stack = np.repeat(np.arange(PLANES, dtype=np.uint16), ROWS * COLUMNS).reshape(PLANES, ROWS, COLUMNS)  # each plane holds its number


def told(group, **values):
    """Store attributes as Imaris does, as arrays of single characters."""
    for name, value in values.items():
        group.attrs[name] = np.array(list(str(value)), dtype="S1")


with h5py.File("stack.ims", "w") as file:
    told(file.create_group("DataSetInfo/Image"), X=COLUMNS, Y=ROWS, Z=PLANES, ExtMin0=0, ExtMin1=0, ExtMin2=0, ExtMax0=1, ExtMax1=0.25, ExtMax2=4)
    channel = file.create_group("DataSet/ResolutionLevel 0/TimePoint 0/Channel 0")
    told(channel, ImageSizeX=COLUMNS, ImageSizeY=ROWS, ImageSizeZ=PLANES, HistogramMin=0, HistogramMax=7)
    channel.create_dataset("Data", data=stack, chunks=(1, ROWS, COLUMNS))

stack_read = ims("stack.ims", squeeze_output=False)
parts = {"0:5": np.s_[0, 0, 0:5], ":5": np.s_[0, 0, :5], "5": np.s_[0, 0, 5], ":5:1": np.s_[0, 0, :5:1], "-1": np.s_[0, 0, -1], "3:": np.s_[0, 0, 3:]}
found = {name: stack_read[part][0, 0, :, 0, 0].tolist() for name, part in parts.items()}
columns = stack_read[0, 0, 0:1, 0:1, :4].shape[-1]
print("imaris-ims-file-reader", version("imaris-ims-file-reader"), "planes given of 0 to 7:", found, "columns of :4:", columns)
print("micrometres of a voxel of 1/16 in x and y:", stack_read.resolution[1:])
assert found == {"0:5": [0, 1, 2, 3, 4], ":5": [5], "5": [5], ":5:1": [4], "-1": [], "3:": [3, 4, 5, 6, 7]}, "planes: the behaviour has changed"
assert columns == 1 and stack_read.resolution == (0.5, 0.062, 0.062), "columns or voxels: the behaviour has changed"
PY
