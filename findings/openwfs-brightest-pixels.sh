#!/usr/bin/env bash
# A good guess: OpenWFS's HDRCamera, which takes one picture at several exposure times, gives a pixel that is saturated at the shortest, too, the
# most that it can tell: the threshold divided by the shortest exposure's share. Found: it gives it the threshold itself, that of the full
# exposure: beside 5 million counts, 8 million are 60,000, so that the middle of a lamp is a hundred times darker than its border.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check nidaqmx==1.7.0 pyserial==3.5 PyOpenGL==3.1.10 glfw==2.11.0 astropy==8.0.2 scipy==1.17.1 numpy==2.4.6 matplotlib==3.11.2 opencv-python-headless==5.0.0.93 annotated-types==0.8.0
v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps openwfs==1.1.0
OMP_NUM_THREADS=1 MPLBACKEND=agg v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import astropy.units as u
import numpy as np
from openwfs.processors import HDRCamera
from openwfs.simulation import Camera, StaticSource
from openwfs.utilities import set_pixel_size

light = np.array([[1e3, 5e4, 5e5, 5e6, 5.9e6, 6.1e6, 8e6]], np.float32)
camera = Camera(StaticSource(set_pixel_size(light, 1 * u.um)), analog_max=0xFFFF, digital_max=0xFFFF)
threshold, shares = 60000, (1.0, 0.1, 0.01)
found = np.array(HDRCamera(camera, background=0.0, saturation_threshold=threshold, exposure_factors=shares).read())[0]
print("openwfs", version("openwfs"), "light of", light[0].tolist(), "is measured as", found.tolist(), f"(threshold {threshold} at shares of {shares})")
assert np.allclose(found[:5], light[0, :5], rtol=0.01)
assert np.array_equal(found[5:], [threshold] * 2), "the behaviour has changed"
PY
