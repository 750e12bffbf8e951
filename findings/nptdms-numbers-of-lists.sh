#!/usr/bin/env bash
# A good guess: npTDMS writes a list of numbers with the type that NumPy would give it, and an array in the order of bytes that it has.
# Found: a list gets the smallest type that holds its first number, or all if they are integers: [0, 0.25, 0.5] mm are written as bytes, 0, 0
# and 0, while [0.0, 0.25, 0.5] are right. An array of big-endian numbers is written byte by byte as if it were little-endian: 1 becomes 256.
# Neither is an error or a warning.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check nptdms==1.13.0 numpy==2.4.6
v/bin/python -W error - <<'PY'
from importlib.metadata import version

import numpy as np
from nptdms import ChannelObject, TdmsFile, TdmsWriter


def read_back(numbers):
    with TdmsWriter("stage.tdms") as writer:
        writer.write_segment([ChannelObject("stage", "position", numbers)])
    return TdmsFile.read("stage.tdms")["stage"]["position"][:]


whole_first, point_first = read_back([0, 0.25, 0.5, 12.75]), read_back([0.0, 0.25, 0.5, 12.75])
native, foreign = read_back(np.array([1, 2, 300], "<i2")), read_back(np.array([1, 2, 300], ">i2"))
print("npTDMS", version("nptdms"), "[0, 0.25, 0.5, 12.75] read as", whole_first.dtype, whole_first, "begun with 0.0 as", point_first)
print("1, 2 and 300, little-endian:", native, "big-endian:", foreign)
assert whole_first.dtype == np.int8 and whole_first.tolist() == [0, 0, 0, 12], "lists: the behaviour has changed"
assert point_first.tolist() == [0, 0.25, 0.5, 12.75], "lists of floats: the behaviour has changed"
assert native.tolist() == [1, 2, 300] and foreign.tolist() == [256, 512, 11265], "arrays: the behaviour has changed"
PY
