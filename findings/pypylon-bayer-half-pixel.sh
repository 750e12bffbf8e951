#!/usr/bin/env bash
# A good guess: Basler's ImageFormatConverter interpolates a Bayer mosaic about each pixel, so that a ramp of grey stays where it is.
# Found: each pixel takes the colours of the square of four pixels that begins with it: the picture moves half a pixel up and left in
# all three colours, and the last row and column, which have no such square, are black unless InconvertibleEdgeHandling says otherwise.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pypylon==26.9 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from pypylon import pylon

STEP_DN = 10
converter = pylon.ImageFormatConverter()
converter.OutputPixelFormat = pylon.PixelType_RGB8packed
across = np.tile(np.arange(16, dtype=np.uint8) * STEP_DN, (16, 1))
moved = []
for mosaic in (pylon.PixelType_BayerRG8, pylon.PixelType_BayerGB8):
    for axis, ramp in ((1, across), (0, np.ascontiguousarray(across.T))):
        image = pylon.PylonImage()
        image.AttachArray(ramp, mosaic)
        colours = converter.Convert(image).Array.astype(float)
        inner = (slice(2, 12),) * 2
        moved.append([float((colours[..., c] - ramp)[inner].mean() / STEP_DN) for c in range(3)])
        edge = colours.take(-1, axis=axis).max(), colours.take(-2, axis=axis).max()
        assert edge[0] == 0 < edge[1], "the behaviour has changed"
print("pypylon", version("pypylon"), "the ramp lies, px from its place:", moved, "and its last line is black")
assert np.allclose(moved, 0.5), "the behaviour has changed"
PY
