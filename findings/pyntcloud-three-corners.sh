#!/usr/bin/env bash
# A good guess: pyntcloud reads faces of a PLY file as many corners as each has, or refuses those that are no triangles. Found: it takes three
# of each: of a text file's square half is left, and in a binary file all that follows the first square is read at the wrong place: a corner
# number 50331648 of four.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pyntcloud==0.3.1 numpy==2.4.6 pandas==3.1.1
v/bin/python - <<'PY'
import struct
from importlib.metadata import version
from pathlib import Path

from pyntcloud import PyntCloud

corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
faces = [(0, 1, 2, 3), (0, 1, 2)]
head = "ply\nformat {} 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
head += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
rows = [*corners, *((len(face), *face) for face in faces)]
Path("text.ply").write_text(head.format("ascii") + "".join(" ".join(map(str, row)) + "\n" for row in rows))
content = b"".join(struct.pack("<3f", *corner) for corner in corners)
content += b"".join(struct.pack(f"<B{len(face)}i", len(face), *face) for face in faces)
Path("binary.ply").write_bytes(head.format("binary_little_endian").encode() + content)
found = {name: PyntCloud.from_file(name).mesh.to_numpy(int).tolist() for name in ("text.ply", "binary.ply")}
print("pyntcloud", version("pyntcloud"), "corners of a square and a triangle:", found)
assert found["text.ply"] == [[0, 1, 2], [0, 1, 2]] and found["binary.ply"][1][0] > 1_000_000, "the behaviour has changed"
PY
