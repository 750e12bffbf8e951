#!/usr/bin/env bash
# A good guess: picosdk's adc2mV makes millivolts of a PicoScope's counts, whether they lie in an array of ctypes, as its page says, or in one of
# NumPy, as in Pico's examples of streaming. Found: with NumPy 2 it multiplies 16 bits in 16 bits: in the range of 2 V 1000 mV
# become 0.19, with a RuntimeWarning once; all counts above 16 are wrong. The same counts of ctypes, or as NumPy's int64, are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check picosdk==1.1 numpy==2.4.6
v/bin/python - <<'PY'
import ctypes
from importlib.metadata import version

import numpy as np
from picosdk.functions import adc2mV

TWO_VOLTS, FULL_SCALE = 7, ctypes.c_int16(32512)
counts = np.array([0, 16, 17, 100, 16256, 32512, -32512], np.int16)
of_ctypes = adc2mV((ctypes.c_int16 * len(counts))(*counts.tolist()), TWO_VOLTS, FULL_SCALE)
of_numpy = [float(value) for value in adc2mV(counts, TWO_VOLTS, FULL_SCALE)]
wider = adc2mV(counts.astype(np.int64), TWO_VOLTS, FULL_SCALE)
print("picosdk", version("picosdk"), "numpy", np.__version__, "counts", counts.tolist())
print("mV of ctypes", np.round(of_ctypes, 3).tolist(), "of int16", np.round(of_numpy, 3).tolist())
assert np.allclose(of_ctypes, counts.astype(float) * 2000 / 32512) and np.allclose(of_ctypes, wider), "the behaviour has changed"
assert np.allclose(of_numpy[:2], of_ctypes[:2]), "small counts: the behaviour has changed"
assert np.round(of_numpy[2:], 3).tolist() == [-0.97, 0.104, 0.189, 0.378, -0.378], "int16: the behaviour has changed"
PY
