#!/usr/bin/env bash
# A good guess: trimesh's voxels of a mesh have about its volume, and the mesh made of them by marching_cubes is in the mesh's units and place.
# Found: a box of 1 m in voxels of 0.1 m, filled, has 11 of them along each side and 1.331 m³; a ball is 10 % too large at 40 voxels
# across. The mesh of marching_cubes is in voxels and counts from the first: 36,480 m³ for a ball of 4.2, at another place.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check trimesh==5.2.0 numpy==2.4.6 scipy==1.17.1 scikit-image==0.26.0
v/bin/python - <<'PY'
import numpy as np
import trimesh

box = trimesh.creation.box([1, 1, 1]).voxelized(0.1).fill()
ball = trimesh.creation.icosphere(radius=1)
ball.apply_translation([10, 0, 0])
voxels = ball.voxelized(0.05).fill()
surface = voxels.marching_cubes
placed = surface.copy().apply_transform(voxels.transform)
print("trimesh", trimesh.__version__, "a box of 1 in voxels of 0.1:", box.shape, "volume", box.volume)
print("a ball of", ball.volume, "in voxels:", voxels.volume, "their surface:", surface.volume, "around", surface.bounds.mean(axis=0))
print("by the voxels' transform:", placed.volume, "around", placed.bounds.mean(axis=0))
assert tuple(box.shape) == (11, 11, 11) and np.isclose(box.volume, 1.331), "boxes: the behaviour has changed"
assert 1.05 < voxels.volume / ball.volume < 1.15, "balls: the behaviour has changed"
assert surface.volume > 1000 * ball.volume and abs(surface.bounds.mean(axis=0)[0] - 10) > 5, "surfaces: the behaviour has changed"
assert np.isclose(placed.volume, surface.volume * 0.05**3) and np.allclose(placed.bounds.mean(axis=0), [10, 0, 0], atol=0.05), "the behaviour has changed"
PY
