#!/usr/bin/env bash
# A good guess: psfmodels centres a point at every oversample_factor, of which larger ones are better; and vectorial_psf_deriv() gives the slopes of
# the PSF beside which it returns them, as fits of single molecules need. Found: an even factor, 2 as 10, moves the whole PSF by half of its finer
# pixels to the upper left: by a quarter of a pixel for 2, 25 nm of 100. The slopes are of the PSF before it is divided by its peak,
# normalize=True or not, and for a metre, whereas all lengths are in micrometres: 1.9 million times those of the returned picture.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check psfmodels==0.3.3 scipy==1.17.1 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import psfmodels

x = np.arange(41) - 20
centres = {}
for model in ("vectorial", "scalar"):
    for factor in (1, 2, 3, 4, 5, 10):
        picture = psfmodels.make_psf(1, 41, dxy=0.1, oversample_factor=factor, model=model)[0]
        centre = [float((picture.sum(axis) * x).sum() / picture.sum()) for axis in (1, 0)]
        centres[model, factor] = centre
        print("psfmodels", version("psfmodels"), model, f"oversample_factor {factor}: centre {centre[0]:+.3f}, {centre[1]:+.3f} pixels")
for (_, factor), centre in centres.items():
    expected = 0 if factor % 2 else -0.5 / factor
    assert np.allclose(centre, expected, atol=2e-3), "centres: the behaviour has changed"

# The slopes by x and by the point's own height, beside differences of the pictures themselves.
step = 0.001
lens = dict(NA=0.8, ns=1.33, ni=1.0, ni0=1.0, sf=1)
for normalize in (True, False):
    options = dict(wvl=0.5, dxy=0.02, params=lens, normalize=normalize)
    picture, by_x, _, by_z = psfmodels.vectorial_psf_deriv(np.array([0.8]), 41, pz=0.5, **options)
    peak = psfmodels.vectorial_psf(0.8, 41, pz=0.5, **dict(options, normalize=False)).max()
    whole = dict(options, normalize=False)
    above, below = (psfmodels.vectorial_psf(0.8, 41, pz=0.5 + side * step, **whole)[0] for side in (1, -1))
    slopes = np.gradient(picture[0], 0.02, axis=1), (above - below) / (2 * step) / (peak if normalize else 1)
    times = [float((found * slope).sum() / (slope**2).sum()) for found, slope in zip((by_x[0], by_z[0]), slopes)]
    print(f"normalize={normalize}: peak {picture.max():.3f} (of {peak:.3f}); slopes are {times[0]:.4g} and {times[1]:.4g} times those per micrometre")
    expected = 1e6 * (peak if normalize else 1)
    assert np.isclose(times[0], -expected, rtol=0.02), "slopes by x: the behaviour has changed"
    assert np.isclose(times[1], expected, rtol=0.02), "slopes by height: the behaviour has changed"
assert 1.8 < peak < 2, "the peak: the behaviour has changed"
PY
