#!/usr/bin/env bash
# A good guess: a mesh whose units trimesh knows to be millimetres is in metres in a GLB file, since glTF has no other
# unit (specification 2.0, section 3.4), or the writer warns.
# Found: the numbers are written as they are, so that a part of 20 mm is 20 m long in every other program. The unit
# stands in `extras`, which trimesh alone reads: its own round trip looks right.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet trimesh==5.2.0 numpy==2.4.6 pygltflib==1.16.5
cd "$folder"
venv/bin/python -W error - <<'PY'
import pygltflib
import trimesh

part = trimesh.creation.box((20, 10, 5))
part.units = "mm"
part.export("part.glb")
told = pygltflib.GLTF2().load("part.glb")
node = next(node for node in told.nodes if node.mesh is not None)
place = told.meshes[node.mesh].primitives[0].attributes.POSITION
length = told.accessors[place].max[0] - told.accessors[place].min[0]
back = trimesh.load("part.glb", force="mesh")
print("trimesh", trimesh.__version__, "length in the file, metres by the specification:", length, "scale", node.scale)
print("read back by trimesh itself:", back.extents[0], back.units)
assert length == 20 and node.scale is None and node.matrix is None, "the behaviour has changed"
assert back.extents[0] == 20 and back.units == "mm", "the behaviour has changed"
PY
