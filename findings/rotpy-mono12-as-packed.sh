#!/usr/bin/env bash
# A good guess: FLIR's Spinnaker, which rotpy carries, makes bytes of a Mono12 image (two bytes a pixel) by leaving out the lowest four bits.
# Found: it takes the two bytes for Mono12Packed, three of them for two pixels: the whole shows the upper three quarters, bytes mixed, and nothing is
# said; Mono10 likewise. And a mosaic becomes grey by nearest neighbours unless asked otherwise: of an even ramp each second step is 3, the others 17.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check rotpy==0.2.1 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from rotpy.image import Image


def grey(readings, layout, *algorithm):
    rows, columns = readings.shape
    image = Image.create_image(columns, rows, 0, 0, layout, data=bytearray(readings.tobytes()))
    return np.frombuffer(bytes(image.convert_fmt("Mono8", *algorithm).get_image_data()), np.uint8).reshape(rows, columns)


readings = np.tile(np.array([0x000, 0x123, 0x456, 0x789, 0xABC, 0xDEF, 0xFFF, 0x010], "<u2"), (6, 1))
wanted = (readings >> 4).tolist()[0]
found = grey(readings, "Mono12")
stored = np.frombuffer(readings.tobytes(), np.uint8)
packed = stored.reshape(-1, 3)[:, [0, 2]].ravel()
ramp = grey(np.tile(np.arange(0, 160, 10, dtype=np.uint8), (16, 1)), "BayerRG8")[8]
print("rotpy", version("rotpy"), "12-bit readings become", found[0].tolist(), "instead of", wanted, "a ramp of tens", ramp.tolist())
assert np.array_equal(found.ravel(), packed[: found.size]) and found[0].tolist() != wanted, "the behaviour has changed"
assert set(np.diff(ramp.astype(int)).tolist()) == {3, 17}, "the behaviour has changed"
PY
