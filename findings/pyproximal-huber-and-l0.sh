#!/usr/bin/env bash
# A good guess: a proximal operator of PyProximal gives the y for which tau f(y) + (y - x)^2 / 2 is least, of Huber's function soft
# thresholding beyond alpha + tau, of the L0 norm a threshold at sqrt(2 tau sigma). Found: Huber's cuts by tau from alpha on (with
# alpha 0.7 and tau 1 it sends 0.8 to 0 where 0.33 is least), the L0 norm's threshold is tau sigma, and Log1's takes a
# fraction of its step; L1, L2, ETP, Geman, SCAD, Log and circular Huber are right. Seen by trying all y.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pyproximal==0.13.0 pylops==2.8.0 numpy==2.4.6 scipy==1.17.1
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import pyproximal

tried = np.linspace(-5, 5, 2001)


def excess(function, tau):
    """Return how far above the least value the operator's result lies, at worst, and where."""
    worst = (0.0, None, None, None)
    for x in (-3.3, -1.7, -0.8, -0.3, 0.2, 0.6, 1.2, 1.3, 2.1, 4.0):
        y = float(np.ravel(function.prox(np.array([x]), tau))[0])
        values = [tau * float(function(np.array([t]))) + (t - x) ** 2 / 2 for t in (*tried, y)]
        over = values[-1] - min(values[:-1])
        worst = max(worst, (round(over, 3), x, round(y, 2), round(float(tried[int(np.argmin(values[:-1]))]), 2)), key=lambda w: w[0])
    return worst


wrong = {
    "Huber": pyproximal.Huber(alpha=0.7),
    "L0": pyproximal.L0(sigma=0.7),
    "Log1": pyproximal.Log1(sigma=0.5, delta=1.0),
}
right = {
    "L1": pyproximal.L1(sigma=0.7),
    "ETP": pyproximal.ETP(sigma=0.5, gamma=0.5),
    "Geman": pyproximal.Geman(sigma=0.5, gamma=1.3),
    "SCAD": pyproximal.SCAD(sigma=0.5, a=3.7),
    "Log": pyproximal.Log(sigma=0.5, gamma=1.0),
    "HuberCircular": pyproximal.HuberCircular(alpha=0.7),
}
found = {name: excess(function, 1.0) for name, function in {**wrong, **right}.items()}
print("pyproximal", version("pyproximal"), "name: above the least value by, at x, given y, best y")
for name, worst in found.items():
    print(name, *worst)
assert all(found[name][0] > 0.1 for name in wrong), "what was wrong has changed"
assert all(found[name][0] < 0.01 for name in right), "what was right has changed"
PY
