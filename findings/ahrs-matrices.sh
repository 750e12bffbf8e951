#!/usr/bin/env bash
# A good guess: AHRS's DCM(rpy=...) makes the matrix of roll, pitch and yaw, as its page says and its Quaternion does, to_rpy() gives them back, and
# angular_distance() is the angle between two matrices. Found: roll and yaw are exchanged; to_rpy() is that of the transposed matrix, so
# that 10, 20 and 30 degrees come back as -28.5, -22.2 and 1.1; the distance is 1.41 times the angle, 56.6 degrees for 40, and below a third
# of a degree nothing: 0.3 degrees are 0. The same of quaternions, qad(), is right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check --no-deps AHRS==0.4.0 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from ahrs import DCM, Quaternion
from ahrs.utils.metrics import angular_distance, qad

angles = np.radians([10.0, 20, 30])  # roll, pitch, yaw
quaternion = Quaternion(rpy=angles)
matrix = DCM(rpy=angles)
of_matrix = np.degrees(Quaternion(matrix.to_quaternion()).to_angles())
back, of_right = np.degrees(matrix.to_rpy()), np.degrees(DCM(quaternion.to_DCM()).to_rpy())
print("AHRS", version("ahrs"), "roll, pitch and yaw 10, 20, 30: quaternion", np.degrees(quaternion.to_angles()).round(2))
print("matrix", of_matrix.round(2), "and by to_rpy()", back.round(2), "of the right matrix", of_right.round(2))
assert np.allclose(quaternion.to_angles(), angles), "quaternions: the behaviour has changed"
assert np.allclose(of_matrix, [30, 20, 10]), "the matrix: the behaviour has changed"
assert np.allclose(back, [-28.45177526, -22.24218091, 1.11605468]) and np.allclose(of_right, back[::-1]), "to_rpy: the behaviour has changed"


def distances(degrees):
    half = np.radians(degrees) / 2
    turn = np.array([np.cos(half), 0, 0, np.sin(half)])
    turned = np.asarray(Quaternion(turn).to_DCM())
    return np.degrees(angular_distance(np.eye(3), turned)), np.degrees(qad(np.array([1.0, 0, 0, 0]), turn))


for degrees in (40, 0.3):
    print("a turn by", degrees, "degrees: distance of matrices", distances(degrees)[0], "of quaternions", distances(degrees)[1])
assert np.allclose(distances(40), [40 * np.sqrt(2), 40]), "the distance: the behaviour has changed"
assert np.allclose(distances(0.3), [0, 0.3]), "small distances: the behaviour has changed"
PY
