#!/usr/bin/env bash
# A good guess: PyMeshLab moves and turns a mesh by what it is told, and its Hausdorff distance is the largest of all samples. Found: a move
# is cut at five times the diagonal of the mesh's bounding box, a turn at 360 degrees, and the distance to another mesh at twice the two boxes'
# common diagonal, all without a word: a triangle with sides of 1 moves by 7.07 instead of 10. For the Hausdorff distance, samples farther away than
# half of a diagonal do not count: 0.1 where one point lies 30 away, and for a mesh 0.8 above another one a largest distance of 0.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pymeshlab==2025.7.post1 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import pymeshlab

corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])


def layers(*points):
    """Return a set of one triangle for each array of corners."""
    meshes = pymeshlab.MeshSet()
    for each in points:
        meshes.add_mesh(pymeshlab.Mesh(each, np.array([[0, 1, 2]])))
    return meshes


def changed(command, **settings):
    meshes = layers(corners)
    getattr(meshes, command)(**settings)
    return meshes.current_mesh().vertex_matrix().round(4)


def hausdorff(points):
    meshes = layers(corners, points)
    return meshes.get_hausdorff_distance(sampledmesh=1, targetmesh=0)


moved = [changed("compute_matrix_from_translation", axisx=float(by))[0, 0].item() for by in (5, 10, 100)]
turned = changed("compute_matrix_from_rotation", rotaxis="Z axis", angle=450.0)[1]
print("PyMeshLab", version("pymeshlab"), "moves by 5, 10 and 100:", moved, "(1, 0, 0) turned by 450 degrees:", turned)
assert np.allclose(moved, [5, 7.0711, 7.0711]), "moves: the behaviour has changed"
assert np.allclose(turned, [1, 0, 0]), "turns: the behaviour has changed"

near, far = hausdorff(corners + [0, 0, 0.7]), hausdorff(corners + [0, 0, 0.8])
outlier = hausdorff(np.array([[0, 0, 0.1], [0.2, 0.2, 0.1], [0.1, 0.1, 30]]))
print("largest distance from 0.7 above", near["max"], "0.8 above", far["max"], "with a point 30 above", outlier["max"], "samples", outlier["n_samples"])
assert np.isclose(near["max"], 0.7) and far["max"] == 0 and far["n_samples"] == 0, "far meshes: the behaviour has changed"
assert np.isclose(outlier["max"], 0.1) and outlier["n_samples"] == 2, "outliers: the behaviour has changed"

apart = layers(corners, corners + [0, 0, 20])
apart.compute_scalar_by_distance_from_another_mesh_per_vertex(measuremesh=1, refmesh=0)
distances = apart.mesh(1).vertex_scalar_array()
print("distances of corners 20 above", distances)
assert np.all(distances < 10) and np.ptp(distances) == 0, "distances: the behaviour has changed"
PY
