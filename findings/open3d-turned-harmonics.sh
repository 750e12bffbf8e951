#!/usr/bin/env bash
# A good guess: Open3D 0.20, which reads files of Gaussian splats, turns the harmonics of their colours along with positions
# and orientations when `rotate` is called (its `transform` warns that it does not, and advises `rotate`).
# Found: orientations are turned rightly and harmonics are not. Twelve turns by 30 degrees about z, which are no turn at all,
# leave the second degree 64 times as large: the matrix that is applied to it is no rotation, whatever convention of
# signs one assumes. The first degree keeps its length, but a turn about x (or y) turns it the other way: a colour that is
# brightest towards +y before a turn that takes +y to +z is brightest towards -z after it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet open3d==0.20.0 plyfile==1.1.5 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PY'
import numpy as np
import open3d
import plyfile

NAMES = [*"xyz", *(f"f_dc_{k}" for k in range(3)), *(f"f_rest_{k}" for k in range(24)), "opacity"]
NAMES += [*(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
one = np.zeros(1, [(name, "f4") for name in NAMES])
one["y"], one["rot_0"] = 1, 1
# Channel by channel (red first): three of the first degree, five of the second. Brightest towards +y: -0.4886 y is the
# first function of the first degree. And one of the second degree.
one["f_rest_0"], one["f_rest_3"] = -1, 1
plyfile.PlyData([plyfile.PlyElement.describe(one, "vertex")]).write("one.ply")


def turned(axis, degrees, times=1):
    cloud = open3d.t.io.read_point_cloud("one.ply")
    angle = np.radians(degrees)
    matrix = np.eye(3)
    first, second = {"x": (1, 2), "z": (0, 1)}[axis]
    matrix[[first, second, first, second], [first, second, second, first]] = (
        np.cos(angle), np.cos(angle), -np.sin(angle), np.sin(angle),
    )
    for _ in range(times):
        cloud.rotate(open3d.core.Tensor(matrix), open3d.core.Tensor(np.zeros(3)))
    return (cloud.point[name].numpy()[0] for name in ("positions", "rot", "f_rest"))


place, orientation, harmonics = turned("z", 30, times=12)
print("Open3D", open3d.__version__, "after twelve turns by 30 degrees about z: place", place.round(3), "orientation",
      orientation.round(3), "first degree", harmonics[:3, 0].round(3), "second", harmonics[3:, 0].round(3), "(was 1 0 0 0 0)")
assert np.allclose(place, [0, 1, 0], atol=1e-4) and np.allclose(np.abs(orientation), [1, 0, 0, 0], atol=1e-4)
assert np.linalg.norm(harmonics[3:, 0]) > 10, "the behaviour has changed: the second degree is kept"

place, _, harmonics = turned("x", 90)
brightest = np.array([-harmonics[2, 0], -harmonics[0, 0], harmonics[1, 0]])  # x, y, z of the first degree
print("a quarter turn about x: +y goes to", place.round(3), "and the brightest direction from +y to", brightest.round(3))
assert np.allclose(place, [0, 0, 1], atol=1e-4)
assert np.allclose(brightest, [0, 0, -1], atol=1e-4), "the behaviour has changed: the first degree turns otherwise"
PY
