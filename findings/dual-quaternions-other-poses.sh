#!/usr/bin/env bash
# A good guess: in dual_quaternions, quotients, powers and logarithms of poses are what their names say: a / b * b, the first power of a, the square
# of its root, and the exponential of its logarithm are a. Found: none is. Quotients are right only where turns commute: a move of (1, 2, 3) m by
# a turn of one radian about z moves by (-1.14, 1.92, 3). Powers move a pose to another place if its quaternion's real part is below 0,
# which is the same turn, and the exponential of the logarithm does nearly always. Screw interpolation is right, but refuses two equal poses.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check dual-quaternions==0.4.0 pyquaternion==0.9.9 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from dual_quaternions import DualQuaternion

random = np.random.default_rng(0)


def pose(turn=None, move=None):
    """Return a pose of quaternion wxyz and metres, at random where they are not given."""
    turn = random.normal(size=4) if turn is None else turn
    move = random.normal(size=3) if move is None else move
    return DualQuaternion.from_quat_pose_array([*(turn / np.linalg.norm(turn)), *move])


def apart(first, second):
    """Return how far two poses' matrices are apart."""
    return float(abs(first.homogeneous_matrix() - second.homogeneous_matrix()).max())


found = {}
for sign in (1, -1):
    poses = [pose() for _ in range(100)]
    poses = [each for each in poses if each.q_r.w * sign > 0]
    others = [pose() for _ in poses]
    ways = {
        "inverse": lambda a, b: a * b.inverse() * b,
        "a / b * b": lambda a, b: (a / b) * b,
        "pow(1)": lambda a, b: a.pow(1),
        "sqrt squared": lambda a, b: a.sqrt() * a.sqrt(),
        "exp of log": lambda a, b: a.log().exp(),
        "whole screw": lambda a, b: DualQuaternion.sclerp(b, a, 1),
    }
    for name, way in ways.items():
        far = [apart(way(a, b), a) for a, b in zip(poses, others)]
        found[name, sign] = far
        print("dual-quaternions", version("dual-quaternions"), f"{name:12} real part {'above' if sign > 0 else 'below'} 0: off by {min(far):.3g} to {max(far):.3g}")
for name, sign in found:
    far = found[name, sign]
    if name in ("inverse", "whole screw"):
        assert max(far) < 1e-9
    elif name in ("pow(1)", "sqrt squared"):
        assert max(far) < 1e-9 if sign > 0 else min(far) > 1e-3, "powers: the behaviour has changed"
    else:
        assert np.median(far) > 0.1, "quotients or logarithms: the behaviour has changed"

move, turn = pose([1, 0, 0, 0], [1, 2, 3]), pose([np.cos(0.5), 0, 0, np.sin(0.5)], [0, 0, 0])
quotient, product = (np.round(np.float64(each.translation()), 2).tolist() for each in (move / turn, move * turn.inverse()))
print("a move of (1, 2, 3) by a turn:", quotient, "times its inverse:", product)
assert quotient == [-1.14, 1.92, 3] and product == [1, 2, 3], "a quotient: the behaviour has changed"
try:
    DualQuaternion.sclerp(move, move, 0.5)
except AttributeError as error:
    print("between equal poses:", error)
else:
    raise SystemExit("equal poses: the behaviour has changed")
PY
