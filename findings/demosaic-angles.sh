#!/usr/bin/env bash
# A good guess: in the package demosaic, made for cameras behind polarisers, angle() gives the angle of polarisation, half of the arc tangent of S2
# over S1, and stokes() the intensity as S0. Found: S1 and S2 are exchanged: 0 degrees are 45, 45 are 0, 30 are 15, and what turns to the left turns to
# the right. S0 is half of the intensity. A mosaic's four channels are counted down its columns: of the pattern that Sony prints as 90, 45 and 135, 0 in
# rows, the code MONO_090_045_135_000 gives 45 degrees more than the light has.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check demosaic==1.1.3 opencv-python-headless==5.0.0.93 numpy==2.4.6
OMP_NUM_THREADS=1 v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
from demosaic import colour, polarisation

angles = np.array([0, 30, 45, 60, 90, 120, 135])
found = {}
for degrees in angles:
    turn = np.radians(degrees)

    def behind(polariser):
        return np.cos(turn - np.radians(polariser)) ** 2

    sony = np.tile([[behind(90), behind(45)], [behind(135), behind(0)]], (4, 4))
    views = polarisation.demosaic(sony, blur_kernel=0)
    down = polarisation.stokes(views, colour.MONO_090_135_045_000)[1, 1]
    of_stokes = polarisation.angle(np.array([1, np.cos(2 * turn), np.sin(2 * turn)]))
    of_mosaic = [polarisation.angle(views, code)[1, 1] for code in (colour.MONO_090_135_045_000, colour.MONO_090_045_135_000)]
    found[int(degrees)] = np.degrees([of_stokes, *of_mosaic]).round(2) % 180, down.round(3)
    print("demosaic", version("demosaic"), f"{degrees} degrees: of S1 and S2 {found[degrees][0][0]}; of a mosaic by 090_135_045_000 {found[degrees][0][1]}, by 090_045_135_000 {found[degrees][0][2]}; S0, S1, S2 of light of 1:", down.round(3).tolist())
seen = np.array([each for each, _ in found.values()])
stokes = np.array([each for _, each in found.values()])
assert np.allclose(stokes[:, 1], np.cos(np.radians(2 * angles)), atol=0.01) and np.allclose(stokes[:, 2], np.sin(np.radians(2 * angles)), atol=0.01)
apart = (seen - np.stack([45 - angles, 45 - angles, 45 + angles], axis=1) + 90) % 180 - 90
assert abs(apart).max() < 0.1, "angles: the behaviour has changed"
assert np.allclose(stokes[:, 0], 0.5, atol=0.01), "S0: the behaviour has changed"
PY
