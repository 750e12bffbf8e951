#!/usr/bin/env bash
# A good guess: angdist(), of spatialmath, is the angle in radians between two turns, whichever of its classes they are given in. Found: between two
# unit quaternions it is half of that, by default and by three of its four metrics of angles; the fourth, said to lie from 0 to 1, goes to pi. Of the
# same two turns as SO3 or SE3 it is all of it. qangle() of the same quaternions is all of it as well.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check spatialmath-python==1.1.18 scipy==1.17.1 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from spatialmath import SE3, SO3, UnitQuaternion
from spatialmath.base import qangle

found = {}
for degrees in (20, 90, 170):
    pairs = {kind: (kind.Rx(5, "deg"), kind.Rx(5 + degrees, "deg")) for kind in (UnitQuaternion, SO3, SE3)}
    angles = [float(np.degrees(first.angdist(second))) for first, second in pairs.values()]
    first, second = pairs[UnitQuaternion]
    metrics = [float(np.degrees(first.angdist(second, metric=metric))) for metric in (1, 2, 3, 4)]
    angles.append(float(np.degrees(qangle(first.A, second.A))))
    found[degrees] = np.array(angles) / degrees, np.array(metrics) / degrees
    print("spatialmath", version("spatialmath-python"), f"turns {degrees} degrees apart, as UnitQuaternion, SO3, SE3 and by qangle:", np.round(angles, 3), "by metrics 1 to 4:", np.round(metrics, 3))
angles, metrics = (np.array([each[part] for each in found.values()]) for part in (0, 1))
assert np.allclose(angles, [0.5, 1, 1, 1]), "the behaviour has changed"
assert np.allclose(metrics, [0.5, 0.5, 0.5, 1]), "metrics: the behaviour has changed"
PY
