#!/usr/bin/env bash
# A good guess: pye57 stores coordinates that it is given as float64 in double precision, which E57 has, and returns as float64.
# Found: it writes each as a single-precision number, without a word, and hands back float64. Surveyors' coordinates of some
# 4,000 km (UTM northings) come back 0.12 m off: a room of points is a lattice. A translation in the scan's pose is
# kept in double precision, so that a writer has to move points near the origin himself.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pye57==0.4.19 numpy==2.4.6
cd "$folder"
"$folder/venv/bin/python" - <<'PY'
from importlib.metadata import version

import numpy as np
import pye57

near = np.linspace(0, 1, 101)
origin = 4_000_000.0


def kept(path, numbers, **pose):
    file = pye57.E57(path, mode="w")
    file.write_scan_raw({"cartesianX": numbers, "cartesianY": numbers, "cartesianZ": numbers}, **pose)
    file.close()
    read = pye57.E57(path)
    points = read.read_scan(0, ignore_missing_fields=True)["cartesianX"]
    assert points.dtype == np.float64
    return float(np.abs(points - near - origin).max())


plain = kept("plain.e57", near + origin)
posed = kept("posed.e57", near, rotation=np.array([1.0, 0, 0, 0]), translation=np.full(3, origin))
print("pye57", version("pye57"), "largest error in m: as given", plain, "with the offset in the pose", posed)
assert 0.1 <= plain <= 0.25, "the behaviour has changed"
assert posed < 1e-6, "the pose is not kept in double precision"
PY
