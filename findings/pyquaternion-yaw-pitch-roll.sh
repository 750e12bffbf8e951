#!/usr/bin/env bash
# A good guess: pyquaternion's yaw_pitch_roll, "following the z-y'-x'' convention", gives the angles of SciPy's intrinsic ZYX, and distance() the angle
# between two turns. Found: it gives those of x-y'-z'': the matrix is Rx Ry Rz, as a further line of its docstring has it; yaw, pitch and roll of
# 69, -40 and 52 degrees are read as 70, 36 and 54, a yaw of 30 and a pitch of 25 alone as 32, 21 and a roll of -13. Small angles and those
# about one axis are right, so that tests with them pass. Distance is half the angle.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check pyquaternion==0.9.9 scipy==1.17.1 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from pyquaternion import Quaternion
from scipy.spatial.transform import Rotation

for degrees in ([69, -40, 52], [30, 0, 0], [30, 25, 0], [3, 2, 1]):
    turn = Rotation.from_euler("ZYX", degrees, degrees=True)
    x, y, z, w = turn.as_quat()
    quaternion = Quaternion(w, x, y, z)
    assert np.allclose(quaternion.rotation_matrix, turn.as_matrix())
    read = np.degrees(quaternion.yaw_pitch_roll)
    other = turn.as_euler("XYZ", degrees=True)[::-1]
    print("pyquaternion", version("pyquaternion"), "z-y'-x'' of", degrees, "is read as", read.round(1).tolist(), "; SciPy's x-y'-z'':", other.round(1).tolist())
    assert np.allclose(read, other), "yaw, pitch and roll: the behaviour has changed"
    assert degrees[1:] == [0, 0] or not np.allclose(read, degrees, atol=0.01)

first, second = (Quaternion(axis=[1, 0, 0], degrees=each) for each in (10, 40))
distance = np.degrees(Quaternion.distance(first, second))
print("distance of turns 30 degrees apart:", round(float(distance), 6), "degrees")
assert np.isclose(distance, 15), "distance: the behaviour has changed"
PY
