#!/usr/bin/env bash
# A good guess: GTSAM's Similarity3, which aligns scenes, maps x to scale * rotation * x + translation as Umeyama's formula and others do.
# Found: it is scale * (rotation * x + translation): translation() of the similarity that moves by (1, 2, 3) and doubles is (0.5, 1, 1.5), and
# the last element of its matrix 1 / scale, so that the upper rows alone map to half of where points belong.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check gtsam==4.3.0 numpy==1.26.4
v/bin/python - <<'PY'
from importlib.metadata import version

import gtsam
import numpy as np

here = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
there = 2 * here + [1, 2, 3]
found = gtsam.Similarity3.Align(list(zip(there, here)))
matrix = found.matrix()
print("GTSAM", version("gtsam"), "scale", round(found.scale(), 6), "translation", found.translation(), "corner", matrix[3, 3])
print("maps (1, 0, 0) to", found.transformFrom(here[1]), "its matrix's upper rows to", (matrix @ [1, 0, 0, 1])[:3])
assert np.allclose(found.transformFrom(here[1]), there[1]) and np.isclose(found.scale(), 2), "the behaviour has changed"
assert np.allclose(found.translation(), [0.5, 1, 1.5]) and np.isclose(matrix[3, 3], 0.5), "the behaviour has changed"
PY
