#!/usr/bin/env bash
# A good guess: HCIPy's NoiselessDetector is its NoisyDetector with all noise left out: with `subsampling` it takes light on a finer grid, and gives
# the sums on its own pixels. Found: it keeps the finer grid: of a detector of 4 x 4 pixels and a subsampling of 2 the picture has 64 pixels,
# each with a quarter of a pixel's light, where the noisy one has 16 with all of it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check hcipy==0.7.1 numpy==2.4.6
OMP_NUM_THREADS=1 v/bin/python - <<'PY'
from importlib.metadata import version

import hcipy
import numpy as np

pixels = hcipy.make_uniform_grid([4, 4], [1, 1])
found = {}
for factor in (1, 2):
    detectors = (
        hcipy.NoiselessDetector(pixels, subsampling=factor),
        hcipy.NoisyDetector(pixels, subsampling=factor, include_photon_noise=False),
    )
    for detector in detectors:
        light = hcipy.Field(np.ones(detector.input_grid.size), detector.input_grid)
        picture = detector(light, dt=1)
        name = type(detector).__name__
        found[name, factor] = picture.size, float(picture.mean()), float(picture.sum())
        print("hcipy", version("hcipy"), name, f"subsampling {factor}: {picture.size} pixels of {picture.mean():g}, {picture.sum():g} in all")
assert found["NoiselessDetector", 1] == found["NoisyDetector", 1] == (16, 1, 16)
assert found["NoisyDetector", 2] == (16, 4, 64)
assert found["NoiselessDetector", 2] == (64, 1, 64), "the behaviour has changed"
PY
