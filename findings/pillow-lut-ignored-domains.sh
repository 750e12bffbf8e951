#!/usr/bin/env bash
# A good guess: pillow_lut's load_cube_file() heeds DOMAIN_MIN and DOMAIN_MAX of a .cube file, so that a table that is the identity from 0 to 2, as
# graded for values above white, changes no picture of 0 to 1. Found: the domain is skipped without a word, each table is taken to be from 0 to 1:
# this one doubles the picture, and one from -0.25 to 1.25 stretches its contrast by a half. Without a domain it is right; colour-science reads each.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check pillow-lut==1.1.0 pillow==12.3.0 colour-science==0.4.7 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import colour
import numpy as np
from PIL import Image
from pillow_lut import load_cube_file

levels = np.array([[[0, 64, 100], [110, 120, 26]]], np.uint8)
found = {}
for low, high in ((0, 1), (0, 2), (-0.25, 1.25)):
    steps = np.linspace(low, high, 17)
    with open("identity.cube", "w") as file:
        file.write("LUT_3D_SIZE 17\n" + f"DOMAIN_MIN {low} {low} {low}\nDOMAIN_MAX {high} {high} {high}\n" * ((low, high) != (0, 1)))
        file.writelines(f"{red:.6f} {green:.6f} {blue:.6f}\n" for blue in steps for green in steps for red in steps)
    found[low, high] = np.array(Image.fromarray(levels).filter(load_cube_file("identity.cube")))
    right = np.rint(255 * colour.read_LUT("identity.cube").apply(levels / 255))
    print("pillow-lut", version("pillow-lut"), f"an identity from {low} to {high}:", levels.ravel().tolist(), "becomes", found[low, high].ravel().tolist(), "; by colour-science", right.ravel().astype(int).tolist())
    assert (right == levels).all()
assert (found[0, 1] == levels).all()
assert (np.abs(found[0, 2].astype(int) - 2 * levels.astype(int)) <= 1).all(), "the behaviour has changed"
assert found[-0.25, 1.25][0, 0, 0] == 0 and abs(int(found[-0.25, 1.25][0, 1, 1]) - (1.5 * 120 - 0.25 * 255)) <= 1, "the behaviour has changed"
PY
