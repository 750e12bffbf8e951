#!/usr/bin/env bash
# A good guess: `rot` of aotools' Zernike functions turns a mode about its centre by that many radians, as their pages say, so that
# phaseFromZernikes(..., rot=) is the whole phase turned. Found: rot is added to the mode's own angle m * theta, so a mode of order m
# turns by rot / m: with 30 degrees the tilt turns by 30, astigmatism by 15, trefoil by 10, and their sum is another phase, not a turned one.
# The turn is against the direction of increasing theta. Turn the picture, or combine the modes of +m and -m.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check aotools==1.0.8 numpy==2.4.6 scipy==1.17.1
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from aotools import phaseFromZernikes, zernike_nm

SIZE, TURN = 201, np.radians(30)
axis = (np.arange(SIZE) - (SIZE - 1) / 2) / (SIZE / 2)
x, y = np.meshgrid(axis, axis)
inside = x**2 + y**2 < 0.8**2
turned = {}
for order in (1, 2, 3):
    mode = zernike_nm(order, order, SIZE, rot=TURN)
    both = np.stack([zernike_nm(order, sign * order, SIZE)[inside] for sign in (1, -1)], 1)
    cosine, sine = np.linalg.lstsq(both, mode[inside], rcond=None)[0]
    turned[order] = float(np.degrees(np.arctan2(sine, cosine))) / order
    print(f"aotools {version('aotools')} order {order}, rot of 30 degrees: the mode turns by {turned[order]:.2f} degrees of increasing theta")

coefficients = [0, 1, 0, 0, 0, 1, 0, 0, 0, 1]
plain, other = phaseFromZernikes(coefficients, SIZE), phaseFromZernikes(coefficients, SIZE, rot=TURN)


def profile(phase, degrees):
    """Values on a circle of half the radius, begun at an angle."""
    angles = np.radians(np.arange(720) / 2 + degrees)
    return phase[np.rint(50 * np.sin(angles) + 100).astype(int), np.rint(50 * np.cos(angles) + 100).astype(int)]


best = min(float(np.std(profile(other, turn / 2) - profile(plain, 0))) for turn in range(720))
print(f"a sum of the three: standard deviation {plain[inside].std():.2f}; at the best of all turns {best:.2f} differ on a circle")
assert np.allclose([turned[order] for order in (1, 2, 3)], [-30, -15, -10], atol=0.01), "the behaviour has changed"
assert best > 0.1, "the behaviour has changed"
PY
