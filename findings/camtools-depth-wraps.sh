#!/usr/bin/env bash
# A good guess: camtools ("with no surprises") writes depth as its page says, cut to 16 bits, and its R_to_quat() gives the quaternion of a rotation.
# Found: depth beyond 65.535 m comes round: a wall at 70 m is at 4.46 m. imwrite() refuses the grey pictures that its page lists, by an assertion without a
# word. And R_to_quat() gives half turns about axes with components of both signs as those about others, where SciPy is right: a camera turned
# upside down and by a right angle comes back 180 degrees off.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check camtools==0.1.8 open3d==0.20.0 opencv-python==5.0.0.93 scipy==1.17.1 numpy==2.4.6
cat > look.py <<'PY'
from importlib.metadata import version

import camtools
import numpy as np
from scipy.spatial.transform import Rotation

metres = np.array([[3.25, 65.5, 65.6, 70.0, 131.25]])
camtools.io.imwrite_depth("depth.png", metres)
read = camtools.io.imread_depth("depth.png")
print("camtools", version("camtools"), "depth", metres[0].tolist(), "becomes", read[0].round(3).tolist())
assert "clipped to uint16 range" in camtools.io.imwrite_depth.__doc__

try:
    camtools.io.imwrite("grey.png", np.zeros((4, 5), np.uint8))
    grey = "written"
except AssertionError as error:
    grey = f"AssertionError({str(error)!r})"
print("a grey picture:", grey)
assert "Grayscale: 2D array" in camtools.io.imwrite.__doc__


def degrees_off(turn):
    quaternion = camtools.convert.R_to_quat(turn)
    back = Rotation.from_quat(np.roll(quaternion, -1)).as_matrix()
    return float(np.degrees(Rotation.from_matrix(back.T @ turn).magnitude()))


upside_down = np.array([[0, -1, 0], [-1, 0, 0], [0, 0, -1.0]])  # x to -y, y to -x, z to -z
other = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1.0]])
assert np.allclose(Rotation.from_matrix(upside_down).as_matrix(), upside_down)
print("half turns, off by degrees:", degrees_off(upside_down), "about (1, -1, 0)", degrees_off(other), "about (1, 1, 0)")
assert np.allclose(read[0, :2], [3.25, 65.5], atol=2e-3)
assert np.allclose(read[0, 2:], metres[0, 2:] % 65.536, atol=2e-3), "the behaviour has changed"
assert grey == "AssertionError('')", "the behaviour has changed"
assert degrees_off(other) < 1e-6
assert degrees_off(upside_down) > 179, "the behaviour has changed"
PY
v/bin/python look.py
