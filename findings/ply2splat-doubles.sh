#!/usr/bin/env bash
# A good guess: ply2splat reads splats' properties in each type that PLY has, or refuses. Found: properties of type double are what they would be
# if they were missing, without a word: a scene with places in double precision lies at the origin, and one all in doubles becomes grey balls
# of radius 1, one over the other, half transparent. Single precision is read, in either order of bytes and as text.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check ply2splat==0.6.0 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import ply2splat

PLACES = ["x", "y", "z"]
OTHERS = ["f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
splat = [1.0, 2, 3, 1, 0, -1, 4, -3, -4, -5, 0.8, 0.6, 0, 0]


def read(doubles):
    """Return what ply2splat reads of one splat, of which the named properties are stored as doubles."""
    names = PLACES + OTHERS
    head = ["ply", "format binary_little_endian 1.0", "element vertex 1"]
    head += [f"property {'double' if name in doubles else 'float'} {name}" for name in names]
    data = np.array([tuple(splat)], dtype=[(name, "<f8" if name in doubles else "<f4") for name in names])
    with open("scene.ply", "wb") as file:
        file.write("\n".join([*head, "end_header", ""]).encode() + data.tobytes())
    found = ply2splat.load_ply_file("scene.ply")[0]
    return found.position, tuple(round(each, 4) for each in found.scale), found.color, found.rotation


single, places, all_of_it = read([]), read(PLACES), read(PLACES + OTHERS)
print("ply2splat", version("ply2splat"), "floats:", *single)
print("places as doubles:", *places, "all as doubles:", *all_of_it)
assert single[0] == (1, 2, 3) and single[1] == (0.0498, 0.0183, 0.0067), "floats: the behaviour has changed"
assert places == ((0, 0, 0), *single[1:]), "places: the behaviour has changed"
assert all_of_it == ((0, 0, 0), (1, 1, 1), (127, 127, 127, 127), (255, 128, 128, 128)), "doubles: the behaviour has changed"
PY
