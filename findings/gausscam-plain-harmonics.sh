#!/usr/bin/env bash
# A good guess: gausscam, which renders splats for simulated robots' cameras, reads the same scene from a plain and from a compressed PLY file. Found:
# of the compressed one it makes harmonics in order of coefficients, each with its red, green and blue, as its cameras need them; those of a
# plain one, all of red's before green's, it leaves as they are: blue's first becomes red's third. And a camera whose axes make a
# half turn, as (1, 0, 0) and (0, -1, 0), which looks straight up with y down, has a rotation of NaN.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check gausscam==0.1.5 plyfile==1.1.5 numpy==2.4.6
npm install --silent --no-fund --no-audit @playcanvas/splat-transform@3.7.0 > npm.log 2>&1
cat > write.py <<'PY'
import numpy as np

COUNT = 500
names = [*"xyz", *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(9)), "opacity"]
names += [*(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
random = np.random.default_rng(0)
splats = np.zeros(COUNT, [(name, "<f4") for name in names])
for name in [*"xyz", "opacity", "f_dc_0", "f_dc_1", "f_dc_2"]:
    splats[name] = random.normal(size=COUNT)
for i in range(3):
    splats[f"scale_{i}"] = random.normal(size=COUNT) - 4
splats["rot_0"] = 1
splats["f_rest_0"], splats["f_rest_6"] = 0.3, -0.2
head = ["ply", "format binary_little_endian 1.0", f"element vertex {COUNT}", *(f"property float {name}" for name in names), "end_header", ""]
with open("scene.ply", "wb") as file:
    file.write("\n".join(head).encode() + splats.tobytes())
PY
cat > read.py <<'PY'
import warnings
from importlib.metadata import version

import numpy as np
from gausscam.core.assets import GaussianCloud
from gausscam.core.rig import quat_from_xyaxes

found = {}
for name in ("scene.ply", "scene.compressed.ply"):
    cloud = GaussianCloud.from_ply(name)
    found[name] = cloud.sh[:, 3:].mean(axis=0).reshape(3, 3)
    print("gausscam", version("gausscam"), name, "coefficients' red, green, blue:", found[name].astype(float).round(2).tolist(), "base colours", cloud.sh[:, :3].mean(axis=0).round(2))
right = [[0.3, 0, -0.2], [0, 0, 0], [0, 0, 0]]
assert np.allclose(found["scene.compressed.ply"], right, atol=0.04)
assert np.allclose(found["scene.ply"], np.transpose(right), atol=1e-6), "harmonics: the behaviour has changed"

turns = {}
for axes in (([0, -1, 0], [0, 0, 1]), ([1, 0, 0], [0, -1, 0]), ([-1, 0, 0], [0, 1, 0])):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        turns[str(axes)] = quat_from_xyaxes(*axes)
    print("axes", axes, "turn", turns[str(axes)])
assert [bool(np.isnan(turn).any()) for turn in turns.values()] == [False, True, True], "half turns: the behaviour has changed"
PY
v/bin/python write.py
node_modules/.bin/splat-transform -w -q scene.ply scene.compressed.ply
v/bin/python read.py
