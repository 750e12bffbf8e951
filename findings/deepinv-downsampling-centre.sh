#!/usr/bin/env bash
# A good guess: the filters of deepinv's Downsampling differ in how much they smooth: changing one for another leaves the
# picture where it is.
# Found: for a factor of 2 "bilinear", "bicubic" and "sinc" put a small pixel over the middle of its four, "gaussian" over
# the first of them: half a pixel of the large picture to the side and up. Two reconstructions that are compared by PSNR,
# or a calibration that is taken from one filter to another, are half a pixel apart, and nothing says so.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet deepinv==0.5.0 torch==2.14.1 numpy==2.4.6
OMP_NUM_THREADS=1 "$folder/venv/bin/python" -W ignore - <<'PY'
import deepinv
import torch
from deepinv.physics import Downsampling

ramp = torch.arange(32.0).expand(1, 1, 32, 32)  # each pixel's value is its column
places = {}
for name in ("bilinear", "bicubic", "sinc", "gaussian"):
    small = Downsampling(img_size=(1, 32, 32), filter=name, factor=2, padding="replicate").A(ramp)
    places[name] = float(small[0, 0, 8, 8])  # the column of the large picture that small column 8 shows
print("deepinv", deepinv.__version__, "column 8 of the small picture shows column", places, "of the large one")
for name in ("bilinear", "bicubic", "sinc"):
    assert abs(places[name] - 16.5) < 0.02, f"{name} lies elsewhere"
assert abs(places["gaussian"] - 16.0) < 0.02, "the behaviour has changed"
PY
