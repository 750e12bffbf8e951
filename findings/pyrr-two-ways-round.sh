#!/usr/bin/env bash
# A good guess: pyrr's matrices and quaternions of one rotation turn a vector alike, and both put roll, pitch and yaw about the same axes. Found: a
# matrix made of a quaternion turns vectors the other way than the quaternion itself, as it is multiplied from the left by a row that it holds
# translations for, and holds rotations for columns; and pitch turns about y in quaternions and about z in matrices, yaw about z and y.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pyrr==0.10.3 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from pyrr import Matrix33, Matrix44, Quaternion, Vector3, Vector4

upwards = Vector3([0.0, 1, 0])
quaternion = Quaternion.from_x_rotation(np.radians(30))
by_quaternion, by_matrix = np.array(quaternion * upwards), np.array(Matrix33.from_quaternion(quaternion) * upwards)
moved = np.array(Matrix44.from_translation([0.0, 0, 5]) * Vector4([0.0, 1, 0, 1]))
print("pyrr", version("pyrr"), "y by 30 degrees about x: quaternion", by_quaternion, "its matrix", by_matrix, "a translation's", moved)
assert np.allclose(by_quaternion, [0, np.cos(np.pi / 6), 0.5]), "quaternions: the behaviour has changed"
assert np.allclose(by_matrix, [0, np.cos(np.pi / 6), -0.5]), "matrices: the behaviour has changed"
assert np.allclose(moved, [0, 1, 5, 1]), "translations: the behaviour has changed"

axes = {}
for number, name in enumerate(("roll", "pitch", "yaw")):
    angles = np.eye(3)[number] * np.radians(30)
    turn = Quaternion.from_matrix(Matrix33.from_eulers(angles))
    axes[name] = [int(np.argmax(np.abs(part[:3]))) for part in (Quaternion.from_eulers(angles), turn)]
    print(name, "turns about", ["xyz"[axis] for axis in axes[name]], "in quaternions and matrices")
assert axes == {"roll": [0, 0], "pitch": [1, 2], "yaw": [2, 1]}, "the angles: the behaviour has changed"
PY
