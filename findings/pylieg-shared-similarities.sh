#!/usr/bin/env bash
# A good guess: in pylieg (import pylie) align_trajectory() lays a trajectory of another size, as one camera without a scale gives, onto the true one;
# umeyama() returns a similarity of its own; SIM3() is the identity; and SIM3.from_list() reads what to_list() wrote. Found: the path is turned and moved
# for the fitted scale but not scaled: one half as large lies 1.7 m off, where a fit without scale is within 0.7. All SIM3 share one shift and one scale: a
# second umeyama() changes the first one's answer, and a new SIM3() is the last fit. from_list() reads each part from the beginning of the list.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check pylieg==0.2.5 scipy==1.17.1 numpy==2.4.6 matplotlib==3.11.2
OMP_NUM_THREADS=1 MPLBACKEND=agg v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
from pylie import R3, SE3, SIM3, SO3, Trajectory
from pylie.analysis import align_trajectory, umeyama

own = version("pylieg")
fresh = SIM3().as_matrix()
times = np.linspace(0, 1, 21).tolist()
true = np.array([[2 + np.cos(3 * t), np.sin(3 * t), 1 + t] for t in times])
turn = SO3.from_euler([0, 0, 30])
middle = true.mean(0)
off = {}
for size in (1.0, 0.5):
    small = [turn.inv() * (size * (point - [1, 2, 3])) for point in true]
    paths = [Trajectory([SE3(SO3(), R3(point)) for point in points], list(times)) for points in (small, true)]
    aligned, fit = align_trajectory(*paths, ret_params=True)
    laid = np.array([pose.x().as_vector() for pose in aligned.get_elements()])
    without = (turn.as_matrix() @ (np.array(small) - np.mean(small, axis=0)).T).T + middle
    off[size] = [float(np.linalg.norm(each - true, axis=1).max()) for each in (laid, without)]
    print("pylieg", own, f"a path of {size} of the size: fitted scale {fit.s().as_float():.3f}; laid on the true one it is up to {off[size][0]:.2f} m off, by a fit without scale {off[size][1]:.2f}")
points = np.random.default_rng(0).normal(size=(3, 10))
first = umeyama(points, 2 * points + np.array([[1], [2], [3]]))
before = first.as_matrix().round(3)
umeyama(points, 5 * points - np.array([[7], [8], [9]]))
after, new = first.as_matrix().round(3), SIM3().as_matrix().round(3)
print("a fit of scale 2 and shift 1, 2, 3:", before[:3].tolist(), "after another fit it is", after[:3].tolist(), "and a new SIM3() is", new[:3].tolist())
given = ["2", *"0.5 0.5 0.5 0.5".split(), *"10 20 30".split()]
read = SIM3.from_list(given, "sqx")
print("from_list of scale 2, a third of a turn and 10, 20, 30 is a", type(read).__name__, read.as_matrix().round(3)[:3].tolist())
assert np.array_equal(fresh, np.eye(4)) and off[1.0][0] < 1e-3 and np.allclose(before[:3, 3], [1, 2, 3]) and np.allclose(before[0, 0], 2)
assert off[0.5][0] > 1.5 > 0.8 > off[0.5][1], "align_trajectory: the behaviour has changed"
assert np.allclose(after[:3, 3], [-7, -8, -9]) and np.allclose(after[0, 0], 5) and np.array_equal(new, after), "umeyama: the behaviour has changed"
assert isinstance(read, SE3) and np.allclose(read.x().as_vector(), [2, 0.5, 0.5]), "from_list: the behaviour has changed"
PY
