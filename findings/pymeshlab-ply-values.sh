#!/usr/bin/env bash
# A good guess: PyMeshLab reads the colours of a PLY file whichever type they have, keeps what else its points hold, such as splats' opacities and
# scales, and writes attributes that were added by hand. Found: colours of 16 bits or floats are white, as if there were none; opacities,
# scales and rotations are gone after a round trip, and so is an attribute that was just added; all without a word.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pymeshlab==2025.7.post1 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import pymeshlab


def read(name, properties, rows):
    """Write points as text with these properties beside their places, and return PyMeshLab's set of them."""
    head = ["ply", "format ascii 1.0", f"element vertex {len(rows)}", *(f"property float {axis}" for axis in "xyz")]
    head += [f"property {each}" for each in properties]
    with open(name, "w") as file:
        file.write("\n".join([*head, "end_header", *(f"{place} 0 0 {row}" for place, row in enumerate(rows)), ""]))
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(name)
    return meshes


def coloured(kind, rows):
    meshes = read("colours.ply", [f"{kind} {channel}" for channel in ("red", "green", "blue")], rows)
    mesh = meshes.current_mesh()  # lives no longer than its set
    return mesh.has_vertex_color(), mesh.vertex_color_matrix()[0, :3].round(3).tolist()


print("PyMeshLab", version("pymeshlab"), "the same colour as bytes", coloured("uchar", ["128 64 0"] * 2))
print("of 16 bits", coloured("ushort", ["32896 16448 0"] * 2), "as floats", coloured("float", ["0.502 0.251 0"] * 2))
assert coloured("uchar", ["128 64 0"] * 2) == (True, [0.502, 0.251, 0]), "bytes: the behaviour has changed"
assert coloured("ushort", ["32896 16448 0"] * 2) == (False, [1, 1, 1]), "16 bits: the behaviour has changed"
assert coloured("float", ["0.502 0.251 0"] * 2) == (False, [1, 1, 1]), "floats: the behaviour has changed"

splats = read("splats.ply", ["float opacity", "float scale_0", "float rot_0"], ["1.5 -4 1", "0.5 -3 1"])
splats.current_mesh().add_vertex_custom_scalar_attribute(np.array([1.5, 0.5]), "weight")
splats.save_current_mesh("written.ply", binary=False)
names = [line.split()[-1] for line in open("written.ply") if line.startswith("property") and "list" not in line]
print("properties of splats, written again", names)
assert names == ["x", "y", "z"], "properties: the behaviour has changed"
PY
