#!/usr/bin/env bash
# A good guess: prysm's camera of 8 or 16 bits reads 255 or 65535 where there is too much light, and its demosaicing of whole
# numbers is that of floating ones, rounded and kept within their range. Found: the reading is cut at 2**bits and put into that many
# bits, so overexposed pixels are 0 (4096 with 12 bits, one more than there are); and demosaic_malvar on uint16 makes white of
# what falls below zero beside an edge, with no word.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check prysm==0.21.1 numpy==2.4.6 scipy==1.17.1
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from prysm.bayer import demosaic_malvar
from prysm.detector import Detector

read = {}
for bits in (8, 12, 16):
    camera = Detector(dark_current=0, read_noise=1, bias=0, fwc=1e9, conversion_gain=10, bits=bits, exposure_time=1)
    light = 10 * 2.0**bits * np.array([[0.25, 0.75, 1.5, 4]])
    read[bits] = [round(float(value) / 2**bits, 1) for value in camera.expose(light)[0]]

rows, columns = np.indices((12, 12))
mosaic = np.where(columns < 6, 1500.0, 50.0)
mosaic[(rows % 2 == 0) & (columns % 2 == 0)] *= 1.3
mosaic[(rows % 2 == 1) & (columns % 2 == 1)] *= 0.7
floating, whole = demosaic_malvar(mosaic)[4, :, 0], demosaic_malvar(mosaic.astype(np.uint16))[4, :, 0]
below, wrapped = float(floating.min()), int(whole.max())
print("prysm", version("prysm"), "readings by 2**bits of 0.25, 0.75, 1.5 and 4 times that light", read)
print("least red beside an edge, floating", below, "largest red, uint16", wrapped, "largest reading", mosaic.max())
assert read[8][2:] == read[16][2:] == [0.0, 0.0], "full scale: the behaviour has changed"
assert read[12][2:] == [1.0, 1.0], "twelve bits: the behaviour has changed"
assert below < 0 < mosaic.max() < 60_000 < wrapped, "demosaicing: the behaviour has changed"
PY
