#!/usr/bin/env bash
# A good guess: point-cloud-utils gives the distance of one point to a mesh as it gives that of the same point among others, and its signed
# distance, with its sign taken off, is that distance. Found: one point alone gets another distance without a word (0.577 for a point that is 1
# above the middle of a square; it answers scalars, so that a loop over points runs through), and signed distances to a surface with a
# border are multiplied by how far the point is outside by winding numbers: 1 becomes 0.872, 0.1 becomes 0.018. To closed ones they are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check point-cloud-utils==0.34.0 trimesh==5.2.0 numpy==2.4.6
v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
import point_cloud_utils as pcu
import trimesh

square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]])
above = np.array([[0.5, 0.5, 1.0], [0.5, 0.5, 0.1]])
together = pcu.closest_points_on_mesh(above, *square)[0]
alone = float(pcu.closest_points_on_mesh(above[:1], *square)[0])
signed = pcu.signed_distance_to_mesh(above, *square)[0]
box = trimesh.creation.box()
to_box = pcu.signed_distance_to_mesh(np.array([[0.0, 0, 1.5], [0, 0, 0.4]]), np.array(box.vertices), np.array(box.faces))[0]
print("point-cloud-utils", version("point-cloud-utils"), "distances", together, "of the first alone", round(alone, 4))
print("signed", signed, "to a closed box", to_box)
assert np.allclose(together, [1, 0.1]) and np.allclose(to_box, [1, -0.1], atol=1e-3), "the behaviour has changed"
assert abs(alone - 0.57735) < 1e-4, "one point alone: the behaviour has changed"
assert np.allclose(signed, [0.8718, 0.0177], atol=1e-3), "surfaces with a border: the behaviour has changed"
PY
