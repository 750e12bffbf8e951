#!/usr/bin/env bash
# A good guess: gsply writes arrays of splats as they are, logarithms of scales and logits of opacities, or what its data is marked as. Found:
# plywrite() and GSData() take scales for lengths if all lie from 0 to 10, and take logarithms once more: Gaussians of 7.4 and 20.1 of the scene's
# millimetres become 2 and 3. Logits from 0 to 1 it takes for opacities: 0.73 becomes 0.9999. Lengths of which one exceeds 10 it takes for
# logarithms. Colours changed by its own to_rgb() it writes as harmonics, though they are marked. Scales of data are changed by writing it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check gsply==0.4.6 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import gsply
import numpy as np

COUNT = 20
places = np.zeros((COUNT, 3), np.float32)
turns = np.tile(np.float32([1, 0, 0, 0]), (COUNT, 1))
colours = np.full((COUNT, 3), 0.8, np.float32)


def written(scales, opacities):
    """Return the scale in units of the scene and the opacity that the file of such splats has."""
    gsply.plywrite("scene.ply", places, np.float32(scales), turns, np.float32(opacities), colours)
    read = gsply.plyread("scene.ply")
    return np.exp(read.scales[0].astype(float)).round(2).tolist(), round(float(1 / (1 + np.exp(-read.opacities[0]))), 4)


metres = written(np.full((COUNT, 3), [-3, -2, -1]), np.full(COUNT, 2.0))
millimetres = written(np.full((COUNT, 3), [1, 2, 3]), np.full(COUNT, 2.0))
logits = written(np.full((COUNT, 3), [-3, -2, -1]), np.full(COUNT, 1.0))
lengths = written(np.full((COUNT, 3), [1, 2, 12]), np.full(COUNT, 2.0))
print("gsply", version("gsply"), "logarithms -3, -2, -1 are lengths and an opacity of", metres, "1, 2, 3 are lengths", millimetres[0], "logit 1:", logits[1])
print("lengths 1, 2, 12 become", lengths[0])
assert metres == ([0.05, 0.14, 0.37], 0.8808), "logarithms below 0: the behaviour has changed"
assert millimetres[0] == [1, 2, 3] and lengths[0][2] > 1e5, "scales: the behaviour has changed"
assert logits[1] == 0.9999, "opacities: the behaviour has changed"

marked = gsply.GSData.from_arrays(places, np.full((COUNT, 3), 0.5, np.float32), turns, np.full(COUNT, 0.5, np.float32), colours, format="linear")
marked.to_rgb()
told = marked.sh0[0, 0]
gsply.plywrite("coloured.ply", marked)
found = gsply.plyread("coloured.ply").sh0[0, 0]
print("harmonic 0.8, by to_rgb", told, "in the file", found, "scales of 0.5 after writing", marked.scales[0, 0])
assert np.isclose(told, 0.7257, atol=1e-4) and found == told, "colours: the behaviour has changed"
assert np.isclose(marked.scales[0, 0], np.log(0.5)), "scales after writing: the behaviour has changed"
PY
