#!/usr/bin/env bash
# A good guess: gaussblur(2) of pyvips blurs by a Gaussian of standard deviation 2 pixels, as gaussian_filter of SciPy does. Found: it cuts the
# Gaussian off where that falls below min_ampl, 0.2 unless told, and scales what is left: the blur's standard deviation is 1.62 for 2, 0.74 for
# 1, and 0 for 0.5, which leaves the picture as it is, whatever the type of the picture and with precision="float", too. A point spread
# function of 1 pixel, simulated so, is a quarter too narrow. With min_ampl=0.01 and precision="float" it is right within a fiftieth from 0.7 on.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check pyvips==3.2.0 pyvips-binary==8.18.7 numpy==2.4.6 scipy==1.17.1
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import pyvips
from scipy.ndimage import gaussian_filter

SIZE = 65
point = np.zeros((SIZE, SIZE), np.float32)
point[SIZE // 2, SIZE // 2] = 1e6
columns = np.arange(SIZE) - SIZE // 2


def spread(picture):
    """Standard deviation along the columns, in pixels."""
    return float(np.sqrt((picture.sum(0) * columns**2).sum() / picture.sum()))


found = {}
for sigma in (0.5, 0.7, 1, 2, 5):
    image = pyvips.Image.new_from_array(point)
    ways = {"default": {}, "float": {"precision": "float"}, "long": {"precision": "float", "min_ampl": 0.01}}
    found[sigma] = {name: spread(image.gaussblur(sigma, **options).numpy().astype(float)) for name, options in ways.items()}
    found[sigma]["scipy"] = spread(gaussian_filter(point.astype(float), sigma))
    print(f"pyvips {version('pyvips')} sigma {sigma}:", {name: round(value, 3) for name, value in found[sigma].items()})
assert found[0.5]["default"] == found[0.5]["float"] == 0, "0.5: the behaviour has changed"
assert 0.7 < found[1]["default"] < 0.78 and 0.7 < found[1]["float"] < 0.78, "1: the behaviour has changed"
assert 1.55 < found[2]["default"] < 1.68 and 3.9 < found[5]["default"] < 4.2, "the behaviour has changed"
for sigma in (0.7, 1, 2, 5):
    assert abs(found[sigma]["long"] / sigma - 1) < 0.02 and abs(found[sigma]["scipy"] / sigma - 1) < 0.01
PY
