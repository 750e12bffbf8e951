#!/usr/bin/env bash
# A good guess: ophyd-async, which gives each signal a type, refuses to set a soft signal to what is not of it, or rounds. Found: a signal of whole numbers
# takes 2.9999999 and holds 2, so that 0.29 mm in hundredths are 28; one of booleans takes "False" and "off" and holds True; arrays of 8
# and 16 bits take 300 and 70000 and hold 44 and 4464. Only a list of 300 for bytes is refused. Without a word.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check ophyd-async==0.21.3 bluesky==1.15.1 numpy==2.4.6
v/bin/python - <<'PY'
import asyncio
from importlib.metadata import version

import numpy as np
from ophyd_async.core import Array1D, soft_signal_rw


async def held(kind, value):
    signal = soft_signal_rw(kind, name="signal")
    await signal.connect()
    await signal.set(value)
    return await signal.get_value()


async def all_held():
    numbers = [await held(int, value) for value in (2.9999999, 0.29 * 100, -2.7, "3")]
    booleans = [await held(bool, value) for value in ("False", "off", "")]
    arrays = [(await held(Array1D[kind], np.array([value]))).tolist() for kind, value in ((np.uint8, 300), (np.uint16, 70000))]
    try:
        refused = await held(Array1D[np.uint8], [300])
    except OverflowError as error:
        refused = str(error)
    return numbers, booleans, arrays, refused


numbers, booleans, arrays, refused = asyncio.run(all_held())
print("ophyd-async", version("ophyd-async"), "2.9999999, 0.29 * 100, -2.7 and '3' as whole numbers:", numbers, end=" ")
print("'False', 'off' and '' as booleans:", booleans, "300 of 8 and 70000 of 16 bits:", arrays, "and in a list:", refused)
assert numbers == [2, 28, -2, 3], "whole numbers: the behaviour has changed"
assert booleans == [True, True, False], "booleans: the behaviour has changed"
assert arrays == [[44], [4464]] and "out of bounds" in refused, "arrays: the behaviour has changed"
PY
