#!/usr/bin/env bash
# A good guess: a column of whole numbers with a unit of unyt, such as a stage's micrometres stored in 16 bits, keeps its digits in other units: whole
# numbers become float64, as in NumPy, astropy and pint. Found: they become floats of their own size, so 8 and 16 bits half precision with
# three digits: 40001 and 65535 um are 40.03 and 65.56 mm, and 30001 and 30002 mm are the same, without a word. Upwards half precision
# ends at 65504: 100 mm in bytes are infinitely many micrometres. 32 bits become single precision, 64 bits double.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check unyt==3.2.0 numpy==2.4.6
v/bin/python - <<'PY'
import warnings
from importlib.metadata import version

import numpy as np
import unyt


def converted(values, kind, unit, other):
    return unyt.unyt_array(np.array(values, kind), unit).to(other)


print("unyt", version("unyt"))
with warnings.catch_warnings():
    warnings.simplefilter("error")
    places = converted([40001, 65535], "u2", "um", "mm")
    same = converted([30001, 30002], "u2", "mm", "m")
    long = converted([16000001], "i4", "nm", "m")
    wide = converted([40001, 65535], "u8", "um", "mm")
print("16 bits:", places, places.dtype, same, "32 bits:", long.dtype, "64 bits:", wide)
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    byte = converted([5, 100], "u1", "mm", "um")
print("bytes:", byte, byte.dtype, [str(one.message) for one in told])
assert places.dtype == np.float16 and np.allclose(places, [40.03, 65.56], atol=0.01), "16 bits: the behaviour has changed"
assert same[0] == same[1] and long.dtype == np.float32, "the behaviour has changed"
assert wide.dtype == np.float64 and np.allclose(wide, [40.001, 65.535]), "64 bits: the behaviour has changed"
assert byte[0] == 5000 and np.isinf(byte[1].value), "bytes: the behaviour has changed"
PY
