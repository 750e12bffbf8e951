#!/usr/bin/env bash
# A good guess: evo aligns an estimated path to the true one wherever both have as many poses and the estimate bends a little: only the turn
# about a straight line would be arbitrary. Found: a true path along a straight line, that of a stage on one rail, is refused for every
# estimate, noisy ones too, and for scale alone; ATE of such a path has to be taken without alignment.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check evo==1.38.1 numpy==2.2.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from evo.core.geometry import GeometryException
from evo.core.trajectory import PoseTrajectory3D

rng = np.random.default_rng(0)
times_s = np.arange(8.0)
turned_not = np.tile([1.0, 0, 0, 0], (8, 1))


def refused(truth, **how):
    estimate = PoseTrajectory3D(2 * truth + rng.normal(0, 0.02, truth.shape), turned_not, times_s)
    try:
        estimate.align(PoseTrajectory3D(truth, turned_not, times_s), **how)
    except GeometryException:
        return True
    return False


line = np.outer(times_s, [0.1, 0, 0])
bent = line + np.outer(np.sin(times_s), [0, 0.01, 0])
ways = ({"correct_scale": True}, {"correct_only_scale": True}, {})
straight, curved = [refused(line, **how) for how in ways], [refused(bent, **how) for how in ways]
print("evo", version("evo"), "refuses a straight truth", straight, "a bent one", curved)
assert all(straight) and not any(curved), "the behaviour has changed"
PY
