#!/usr/bin/env bash
# A good guess: sogpy writes a splat's PLY file as the SOG file that PlayCanvas's splat-transform makes of it. Found: PLY has all of red's harmonics,
# then green's, then blue's; sogpy takes three at a time for one coefficient's red, green and blue: what was blue's first coefficient
# becomes red's third, and colours change with the direction otherwise. Places and base colours come back as they were.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check sogpy==1.0.2 scipy==1.17.1 pillow==13.0.0 numpy==2.4.6
npm install --silent --no-fund --no-audit @playcanvas/splat-transform@3.7.0 > npm.log 2>&1
cat > write.py <<'PY'
import numpy as np

COUNT = 2000
names = [*"xyz", *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(9)), "opacity"]
names += [*(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
random = np.random.default_rng(0)
splats = np.zeros(COUNT, [(name, "<f4") for name in names])
for name in [*"xyz", "opacity", "f_dc_0", "f_dc_1", "f_dc_2"]:
    splats[name] = random.normal(size=COUNT)
for i in range(3):
    splats[f"scale_{i}"] = random.normal(size=COUNT) - 4
splats["rot_0"] = 1
# Red grows along y by its first harmonic, blue falls.
splats["f_rest_0"], splats["f_rest_6"] = 0.3, -0.2
for name in names[6:15]:
    splats[name] += 0.001 * random.normal(size=COUNT)
head = ["ply", "format binary_little_endian 1.0", f"element vertex {COUNT}", *(f"property float {name}" for name in names), "end_header", ""]
with open("scene.ply", "wb") as file:
    file.write("\n".join(head).encode() + splats.tobytes())
PY
cat > compare.py <<'PY'
from importlib.metadata import version

import numpy as np


def read(path):
    """Return the splats of a binary PLY file, sorted by x."""
    head, data = open(path, "rb").read().split(b"end_header\n", 1)
    names = [line.split()[2] for line in head.decode().splitlines() if line.startswith("property")]
    return np.sort(np.frombuffer(data, [(name, "<f4") for name in names]), order="x")


def harmonics(splats):
    """Return the coefficients' means as [red's, green's, blue's]."""
    return np.array([float(splats[f"f_rest_{i}"].mean()) for i in range(9)]).reshape(3, 3).round(2) + 0.0


scene, by_sogpy, by_its_makers = (read(name) for name in ("scene.ply", "sogpy.ply", "makers.ply"))
for label, splats in (("scene", scene), ("splat-transform", by_its_makers), ("sogpy " + version("sogpy"), by_sogpy)):
    places = max(abs(splats[name] - scene[name]).max() for name in "x")
    print(label, "harmonics of red, green, blue:", harmonics(splats).tolist(), f"x within {places:.4f}")
    assert places < 1e-3 and abs(splats["f_dc_0"].mean() - scene["f_dc_0"].mean()) < 1e-2
right = [[0.3, 0, 0], [0, 0, 0], [-0.2, 0, 0]]
assert harmonics(scene).tolist() == harmonics(by_its_makers).tolist() == right
assert harmonics(by_sogpy).tolist() == [[0.3, 0, -0.2], [0, 0, 0], [0, 0, 0]], "the behaviour has changed"
PY
v/bin/python write.py
v/bin/sogpy scene.ply sogpy.sog > sogpy.log
node_modules/.bin/splat-transform -w -q sogpy.sog sogpy.ply
node_modules/.bin/splat-transform -w -q -g cpu scene.ply makers.sog
node_modules/.bin/splat-transform -w -q makers.sog makers.ply
v/bin/python compare.py
