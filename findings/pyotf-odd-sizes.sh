#!/usr/bin/env bash
# A good guess: pyotf's two models of one microscope, Hanser's and Sheppard's, have the focus at one place, the middle of an odd stack. Found: of 15
# planes the focus is in the ninth by both, a plane too late, and of 31 x 31 pixels Sheppard's point lies a pixel to the lower right of the
# middle, where Hanser's is. A deconvolution moves its picture by as much, and the OTF of this symmetric PSF has an imaginary part
# of a third of its peak. Even sizes have both at half the size.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check pyotf==0.0.3 dphtools==0.0.5 scipy==1.17.1 numpy==2.4.6
OMP_NUM_THREADS=1 v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from pyotf.otf import HanserPSF, SheppardPSF

found = {}
for model in (HanserPSF, SheppardPSF):
    for planes, pixels in ((16, 32), (15, 31)):
        point = model(wl=500, na=0.8, ni=1.0, res=80, zres=150, size=pixels, zsize=planes)
        brightest = [int(each) for each in np.unravel_index(point.PSFi.argmax(), point.PSFi.shape)]
        imaginary = float(abs(point.OTFi.imag).max() / abs(point.OTFi).max())
        found[model.__name__, planes] = brightest
        print("pyotf", version("pyotf"), model.__name__, f"{planes} planes of {pixels} x {pixels}: brightest at {brightest}, imaginary part of the OTF {imaginary:.2f}")
assert found["HanserPSF", 16] == found["SheppardPSF", 16] == [8, 16, 16]
assert found["HanserPSF", 15] == [8, 15, 15], "Hanser's: the behaviour has changed"
assert found["SheppardPSF", 15] == [8, 16, 16] and imaginary > 0.3, "Sheppard's: the behaviour has changed"
PY
