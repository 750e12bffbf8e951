#!/usr/bin/env bash
# A good guess: numpy-stl turns a mesh about an axis by the right-hand rule, and one matrix turns it the same way by each of its methods. Found: its rotation_matrix() is the usual
# one, but rotate() and rotate_using_matrix() multiply points by it from the wrong side: rotate() by 90 degrees about z brings x to -y. transform() does it right: one matrix turns
# a mesh one way by it and the other way by the two.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check numpy-stl==4.1.1 scipy==1.17.1 numpy==2.3.5
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from scipy.spatial.transform import Rotation
from stl.mesh import Mesh

about_z = Rotation.from_euler("z", 90, degrees=True).as_matrix()
own = Mesh.rotation_matrix([0, 0, 1], np.pi / 2)


def place_of_x_after(turn):
    mesh = Mesh(np.zeros(1, Mesh.dtype))
    mesh.vectors[0] = [[1, 0, 0], [2, 0, 0], [1, 0, 1]]
    turn(mesh)
    return np.round(mesh.vectors[0, 0]).astype(int).tolist()


def as_transform(matrix):
    whole = np.eye(4)
    whole[:3, :3] = matrix
    return lambda mesh: mesh.transform(whole)


found = {
    "rotate()": place_of_x_after(lambda mesh: mesh.rotate([0, 0, 1], np.pi / 2)),
    "rotate_using_matrix(), its matrix": place_of_x_after(lambda mesh: mesh.rotate_using_matrix(own)),
    "transform(), its matrix": place_of_x_after(as_transform(own)),
    "rotate_using_matrix(), SciPy's": place_of_x_after(lambda mesh: mesh.rotate_using_matrix(about_z)),
    "transform(), SciPy's": place_of_x_after(as_transform(about_z)),
}
print("numpy-stl", version("numpy-stl"), "90 degrees about z bring (1, 0, 0) to", found)
assert np.allclose(about_z @ [1, 0, 0], [0, 1, 0])
assert np.allclose(own, about_z), "the matrix has changed"
assert [place[1] for place in found.values()] == [-1, -1, 1, -1, 1], "the behaviour has changed"
PY
