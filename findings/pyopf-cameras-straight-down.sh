#!/usr/bin/env bash
# A good guess: Pix4D's converter of its open format to COLMAP (opf2colmap in pyopf) gives each calibrated camera its quaternion, and best of all one that looks
# straight down, at omega and phi of 0, which is where these angles are counted from. Found: there the matrix is a half turn, and the quaternion three
# times 0 / 0: NaN in images.txt, whatever kappa, with no more than a warning of NumPy. At some kappas its first number is NaN, too.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pyopf[tools]==1.4.1 scipy==1.17.1 numpy==2.3.5
cat > look.py <<'PY'
from importlib.metadata import version

import numpy as np
from opf_tools.opf2colmap.converter import orient_pos_computation
from scipy.spatial.transform import Rotation

np.seterr(all="ignore")
place = np.array([1.0, 2.0, 30.0])
half_turn = np.diag([1.0, -1.0, -1.0])  # the format's images are right-top-back, COLMAP's right-bottom-front


def both(omega, phi, kappa):
    found, _ = orient_pos_computation(np.array([omega, phi, kappa], float), place)
    true = Rotation.from_matrix(half_turn @ Rotation.from_euler("XYZ", [omega, phi, kappa], degrees=True).as_matrix().T)
    return np.round(found, 4).tolist(), np.round(true.as_quat()[[3, 0, 1, 2]], 4).tolist()


print("pyopf", version("pyopf"), "omega, phi, kappa: quaternion w, x, y, z for COLMAP, and SciPy's")
for angles in ((5, 3, 30), (0, 0, 0), (0, 0, 30), (0, 0, 90)):
    print(angles, *both(*angles))
tilted, true = both(5, 3, 30)
assert min(np.abs(np.subtract(tilted, true)).max(), np.abs(np.add(tilted, true)).max()) < 2e-4, "the convention has changed"
for kappa in (0, 30, 45, 90, -117):
    found, true = both(0, 0, kappa)
    assert np.isnan(found[1:]).all() and np.isfinite(true).all(), "the behaviour has changed"
PY
v/bin/python look.py
