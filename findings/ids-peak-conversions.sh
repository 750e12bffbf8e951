#!/usr/bin/env bash
# A good guess: IDS's image library keeps numbers when a format of more bits takes them (Basler's does: Mono12 to Mono16 leaves 4095), and a
# mosaic converted to Mono8 lies where the one converted to RGB8 lies. Found: Mono12 to Mono16 multiplies by 16 (Mono10 by 64), so
# that black levels and full scales of the camera no longer hold; and Bayer to Mono8 takes the mean of the four pixels that begin with
# each: the grey picture lies half a pixel up and left of the one in colours, and its last column repeats the one before.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check ids-peak-common==2.1.0 ids-peak-ipl==1.18.0 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from ids_peak_ipl import ids_peak_ipl as ipl


def converted(readings, given, wanted):
    memory = np.ascontiguousarray(readings).view(np.uint8).ravel()
    height, width = readings.shape
    of = {name: getattr(ipl, f"PixelFormatName_{name}") for name in (given, wanted)}
    image = ipl.Image.CreateFromSizeAndPythonBuffer(of[given], memory, width, height)
    result = image.ConvertTo(of[wanted])
    array = np.array(result.get_numpy())
    assert result.Width() == width
    return array.reshape(height, width, -1)


twelve = converted(np.uint16([[1, 100, 2047, 4095]]), "Mono12", "Mono16").ravel().tolist()
ten = converted(np.uint16([[1, 100, 511, 1023]]), "Mono10", "Mono16").ravel().tolist()
ramp = np.tile(np.arange(16, dtype=np.uint8) * 10, (8, 1))
inner = (slice(2, 6), slice(2, 12))
colour = converted(ramp, "BayerRG8", "RGB8")[inner].astype(float).mean(axis=(0, 2)) - ramp[inner].mean(axis=0)
grey_picture = converted(ramp, "BayerRG8", "Mono8")[..., 0]
grey = grey_picture[inner].astype(float).mean(axis=0) - ramp[inner].mean(axis=0)
falling = np.ascontiguousarray(ramp[:, :8].T)
down = converted(falling, "BayerRG8", "Mono8")[2:6, 2:6, 0].astype(float) - falling[2:6, 2:6]
moved = float(colour.mean() / 10), float(grey.mean() / 10), float(down.mean() / 10)
print("ids-peak-ipl", version("ids-peak-ipl"), "Mono12", twelve, "Mono10", ten, "ramp displaced, px: RGB8 %.2f, Mono8 %.2f and %.2f down" % moved)
assert twelve == [16, 1600, 32752, 65520] and ten == [64, 6400, 32704, 65472], "the behaviour has changed"
assert abs(moved[0]) < 0.05 and all(0.4 < way < 0.6 for way in moved[1:]) and (grey_picture[:, -1] == grey_picture[:, -2]).all(), "the behaviour has changed"
PY
