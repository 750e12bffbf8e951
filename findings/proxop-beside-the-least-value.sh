#!/usr/bin/env bash
# A good guess: prox(x, gamma) of proxop, the Python part of the Proximity Operator Repository, is the y for which
# gamma f(y) + (y - x)^2 / 2 is least, for each f of the list. Found: it is not for the logistic loss (-3.3 becomes -6.6, where
# that of a rising function of slope below 1 moves by less than gamma), the capped L1 norm (-3.3 becomes -6.1), the squared
# hinge (0.6 becomes 1, the hinge's answer) and the Fair potential; Huber's function, the hinge and the absolute value are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check proxop==1.0.6 numpy==2.4.6 scipy==1.17.1
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import proxop

tried = np.linspace(-8, 8, 3201)
gamma = 0.5


def worst_of(function):
    """Return by how much the result misses the least value, at worst, then x, the result and the best y."""
    worst = (0.0, None, None, None)
    for x in (-3.3, -1.7, -0.8, -0.3, 0.2, 0.6, 1.2, 2.1, 4.0):
        y = float(np.ravel(function.prox(np.array([x]), gamma))[0])
        values = [gamma * float(function(np.array([t]))) + (t - x) ** 2 / 2 for t in (*tried, y)]
        best = int(np.argmin(values[:-1]))
        if values[-1] - values[best] > worst[0]:
            worst = (round(values[-1] - values[best], 3), x, round(y, 2), round(float(tried[best]), 2))
    return worst


wrong = ("LogisticLoss", "CapL1", "SquaredHinge", "FairPotential")
right = ("Huber", "HingeLoss", "AbsValue")
found = {name: worst_of(getattr(proxop, name)(**({"w": 1.0} if name == "Huber" else {}))) for name in (*wrong, *right)}
print("proxop", version("proxop"), "name: above the least value by, at x, given y, best y")
for name, worst in found.items():
    print(name, *worst)
assert all(found[name][0] > 0.03 for name in wrong), "what was wrong has changed"
assert all(found[name][0] < 0.005 for name in right), "what was right has changed"
PY
