#!/usr/bin/env bash
# A good guess: akai-transform's conversions between matrices, quaternions and axis with angle, made for robots' poses, give the same turn back,
# small or large, and its modified Rodrigues parameters are the axis times tan(angle / 4). Found: quat2rvec makes no turn of all below 3.6
# degrees; rmat2rvec knows half turns about x, y and z alone: any other has an axis of zeros, by which nothing turns; of poses less than 0.1
# degrees apart interp_p2p gives the first for all times; and those parameters are the axis times 2 sin(angle / 2).
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check akai-transform==1.0.0 numpy==2.4.6
OMP_NUM_THREADS=1 v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from akai_transform import quat, tf3d

axis = np.array([2.0, -1, 2]) / 3
name = f"akai-transform {version('akai-transform')}"
angles, parameters = {}, {}
for degrees in (1, 3.5, 3.7, 90):
    turn = np.radians(degrees)
    back_axis, back = tf3d.quat2rvec(tf3d.rvec2quat(axis, turn))
    angles[degrees] = float(np.degrees(back))
    parameters[degrees] = float(np.linalg.norm(tf3d.rmat2mrp(tf3d.rvec2rmat(axis, turn))))
    print(name, f"a turn of {degrees} degrees: {angles[degrees]:.4f} from its quaternion; parameters of length {parameters[degrees]:.5f}, tan(angle / 4) is {np.tan(turn / 4):.5f}")
halves = {}
for about in ((1, 0, 0), (1, 1, 0), (2, -1, 2)):
    about = np.array(about) / np.linalg.norm(about)
    matrix = tf3d.rvec2rmat(about, np.pi)
    back_axis, back = tf3d.rmat2rvec(matrix)
    again = tf3d.rvec2rmat(back_axis, back)
    halves[tuple(about.round(3).tolist())] = float(np.linalg.norm(back_axis)), float(abs(again - matrix).max())
    print(name, "a half turn about", about.round(3).tolist(), "has the axis", back_axis.tolist(), f"and comes back with an error of {halves[tuple(about.round(3).tolist())][1]:.3f}")
start, end = (tf3d.rvec2quat(axis, np.radians(degrees)) for degrees in (10, 10.09))
last = quat.interp_p2p(start, end, [0, 0.5, 1])[-1]
print(name, f"the last of the poses from 10 to 10.09 degrees: {2 * np.degrees(np.arccos(last[0])):.4f} degrees")
assert abs(angles[3.7] - 3.7) < 1e-9 and abs(angles[90] - 90) < 1e-9
assert angles[1] == angles[3.5] == 0, "small turns: the behaviour has changed"
assert abs(parameters[90] - 2 * np.sin(np.pi / 4)) < 1e-9, "Rodrigues: the behaviour has changed"
assert halves[(1, 0, 0)][1] < 1e-9
for about in ((0.707, 0.707, 0), (0.667, -0.333, 0.667)):
    assert halves[about][0] == 0 and halves[about][1] > 1, "half turns: the behaviour has changed"
assert np.array_equal(last, start / np.linalg.norm(start)), "interpolation: the behaviour has changed"
PY
