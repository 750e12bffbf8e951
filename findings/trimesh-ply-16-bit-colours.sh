#!/usr/bin/env bash
# A good guess: trimesh scales a PLY file's 16-bit vertex colours to its own 8 bits, as it scales colours in floats (0.5
# becomes 128), or leaves them alone.
# Found: it keeps the lower byte of each. Half of full scale (32768) becomes 0, full scale stays white, and the rest is
# noise of the right shape and type. Scanners and programs for point clouds write such colours.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet trimesh==5.2.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PY'
import io

import trimesh


def read(kind, colours):
    properties = "".join(f"property float {axis}\n" for axis in "xyz")
    properties += "".join(f"property {kind} {name}\n" for name in ("red", "green", "blue"))
    head = f"ply\nformat ascii 1.0\nelement vertex 3\n{properties}"
    head += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    places = ("0 0 0", "1 0 0", "0 1 0")
    text = head + "".join(f"{place} {' '.join(map(str, colours))}\n" for place in places) + "3 0 1 2\n"
    mesh = trimesh.load(io.BytesIO(text.encode()), file_type="ply", process=False)
    return mesh.visual.vertex_colors[0, :3].tolist()


floats, words = read("float", (0.5, 0.25, 1.0)), read("ushort", (32768, 16384 + 7, 65535))
print("trimesh", trimesh.__version__, "floats 0.5 0.25 1:", floats, "words 32768 16391 65535:", words)
assert floats == [128, 64, 255], "colours in floats are read otherwise"
assert words == [0, 7, 255], "the behaviour has changed"
PY
