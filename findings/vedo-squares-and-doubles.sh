#!/usr/bin/env bash
# A good guess: vedo's volume() and area() are those of any closed mesh, and its points keep the double precision of the array they are made of.
# Found: faces of more than three corners count nothing, without a word: its own cube has a volume and an area of 0, a mesh of a square and a
# triangle the triangle's. Until triangulate() is called. Points are single floats: a surveyed place at 5500000.26 m is at 5500000.5, and so are
# distances between two.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check vedo==2026.6.3 numpy==2.4.6
v/bin/python - > said 2> errors <<'PY'
import numpy as np
import vedo

cube = vedo.Cube()
mixed = vedo.Mesh([[(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0)], [[0, 1, 2, 3], [1, 4, 2]]])
cut = cube.clone().triangulate()
print("vedo", vedo.__version__, "a cube of side 1: volume", cube.volume(), "area", cube.area(), "of triangles", cut.volume(), cut.area())
print("a square of 1 beside a triangle of 0.5: area", mixed.area())
assert cube.volume() == 0 and cube.area() == 0, "squares: the behaviour has changed"
assert np.isclose(cut.volume(), 1) and np.isclose(cut.area(), 6), "triangles: the behaviour has changed"
assert np.isclose(mixed.area(), 0.5), "squares and triangles: the behaviour has changed"

surveyed = np.array([[5_500_000.26, 0, 0], [5_500_001.0, 0, 0]])
points = vedo.Points(surveyed).vertices
print("points", points.dtype, points[:, 0].tolist())
assert points.dtype == np.float32 and points[0, 0] == 5_500_000.5, "doubles: the behaviour has changed"
PY
cat said errors
test ! -s errors || { echo "it says something now" >&2; exit 1; }
