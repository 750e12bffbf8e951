#!/usr/bin/env bash
# A good guess: in LightPipes a positive tilt sends a beam to positive x, an angle turns an aperture and a field the same way, and a random phase
# with a largest value of pi, its default, leaves no light undisturbed and differs from call to call. Found: Tilt and PlaneWave with tx = 1 mrad
# move the beam by -1 mm in 1 m; RectAperture(angle=30) turns by -30 degrees, from x towards -y, and Interpol(angle=30) by +30; RandomPhase goes
# from -pi/2 to pi/2, so that 41 percent of the power stay in the undiffused beam, and RandomPhase and RandomIntensity have a fixed seed by
# default: every call draws the same diffuser, and an average over speckles averages nothing.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check LightPipes==2.1.5 numpy==2.4.6 scipy==1.17.1
v/bin/python - <<'PY'
from importlib.metadata import version

import LightPipes as lp
import numpy as np

start = lp.Begin(10 * lp.mm, 0.5 * lp.um, 200)
beam = lp.CircAperture(start, 2 * lp.mm)
tilted = lp.Centroid(lp.Forvard(lp.Tilt(beam, 1 * lp.mrad, 0), 1 * lp.m))[0] / lp.mm
shifted = lp.Centroid(lp.Forvard(lp.CircAperture(start, 1 * lp.mm, x_shift=1 * lp.mm), 1 * lp.m))[0] / lp.mm


def angle(field):
    """Of the long axis, from x (columns) towards y (rows), in degrees."""
    rows, columns = np.nonzero(lp.Intensity(field) > 0.3)
    spread = np.cov(columns, rows)
    return float(np.degrees(np.arctan2(2 * spread[0, 1], spread[0, 0] - spread[1, 1]) / 2))


aperture = angle(lp.RectAperture(start, 4 * lp.mm, 1 * lp.mm, angle=30))
turned = angle(lp.Interpol(lp.RectAperture(start, 4 * lp.mm, 1 * lp.mm), 10 * lp.mm, 200, angle=30))
first, second = lp.RandomPhase(start), lp.RandomPhase(start)
largest = float(lp.Phase(first).max())
left = float(abs(first.field.mean()) ** 2)
same = np.array_equal(first.field, second.field) and np.array_equal(lp.RandomIntensity(start).field, lp.RandomIntensity(start).field)
print(f"LightPipes {version('LightPipes')} tilt of +1 mrad after 1 m: {tilted:.2f} mm; x_shift of +1 mm: {shifted:.2f} mm")
print(f"angle of 30: aperture {aperture:.1f}, interpolated field {turned:.1f} degrees")
print(f"random phase: largest {largest:.3f}, undiffused power {left:.2f}, two calls the same: {same}")
assert -1.05 < tilted < -0.95 and 0.95 < shifted < 1.05, "tilt: the behaviour has changed"
assert abs(aperture + 30) < 0.5 and abs(turned - 30) < 0.5, "angles: the behaviour has changed"
assert 1.5 < largest < np.pi / 2 + 1e-3 and 0.35 < left < 0.45 and same, "random phase: the behaviour has changed"
PY
