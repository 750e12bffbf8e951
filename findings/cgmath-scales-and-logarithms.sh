#!/usr/bin/env bash
# A good guess: in cgmath matrix_decompose() gives each axis its scale, so that the weighted mean of one transformation is that transformation;
# quaternion_log() gives axis * angle, as its page says; products of quaternions and of their matrices agree; and there is a turn from x to -x. Found: scales
# are sorted, the largest first: the mean of one box of 1 x 2 x 3 is a box of 3 x 2 x 1. quaternion_log() gives half of the angle. quaternion_multiply(a, b)
# turns by b first, matrix_multiply() of their matrices by a. vector_arc_to_quaternion() of opposite vectors is NaN.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check cgmath==3.0.0 scipy==1.17.1 numpy==2.4.6
OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1 v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
from cgmath import transforms
from scipy.spatial.transform import Rotation

own = version("cgmath")
sized = {}
for sizes in ((3, 2, 1), (1, 2, 3)):
    box = np.diag([*map(float, sizes), 1.0])
    scale = np.diag(transforms.matrix_decompose(box)[2])[:3]
    mean = transforms.matrix_weighted_transformation([box], [1.0])
    turned = box.copy()
    turned[:3, :3] = box[:3, :3] @ Rotation.from_euler("z", 30, degrees=True).as_matrix().T
    moved = transforms.matrix_weighted_transformation([turned], [1.0])
    sized[sizes] = scale.tolist(), np.diag(mean)[:3].round(3).tolist(), float(abs(moved - turned).max())
    print("cgmath", own, f"scales {sizes} are decomposed to {sized[sizes][0]}; the mean of one such transformation has {sized[sizes][1]}; one turned by 30 degrees differs from its mean by {sized[sizes][2]:.3f}")
turn = Rotation.from_rotvec([[0, 0, 1.0], [0, 0.6, 0]])
first, second = turn.as_quat()[:1], turn.as_quat()[1:]
logarithm = transforms.quaternion_log(first)[0]
print("quaternion_log of a turn by 1 about z:", logarithm.tolist())
matrices = [transforms.quaternion_to_matrix(each) for each in (first, second)]
product = transforms.quaternion_to_matrix(transforms.quaternion_multiply(first, second))
apart = [float(abs(product - transforms.matrix_multiply(*each)).max()) for each in (matrices, matrices[::-1])]
print("the product of two quaternions differs from that of their matrices by", apart[0], ", in the other order by", apart[1])
arcs = transforms.vector_arc_to_quaternion(np.array([[1.0, 0, 0]] * 2), np.array([[0, 1.0, 0], [-1.0, 0, 0]]))
print("turns from x to y and to -x:", arcs.round(3).tolist())
assert np.allclose(arcs[0], [0, 0, 0.5**0.5, 0.5**0.5])
assert sized[3, 2, 1][:2] == ([3, 2, 1], [3, 2, 1]) and apart[1] < 1e-9
assert np.allclose(transforms.quaternion_exp(logarithm[None]), first)
assert sized[1, 2, 3][:2] == ([3, 2, 1], [3, 2, 1]) and sized[1, 2, 3][2] > 1, "matrix_decompose: the behaviour has changed"
assert np.allclose(logarithm, [0, 0, 0.5]), "quaternion_log: the behaviour has changed"
assert apart[0] > 0.1, "products: the behaviour has changed"
assert np.isnan(arcs[1]).all(), "arcs: the behaviour has changed"
PY
