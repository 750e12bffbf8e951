#!/usr/bin/env bash
# A good guess: odak.learn.tools.resize(image, 0.5) halves the height and width of an image of "M x N x 3", as its documentation asks for.
# Found: the array is taken as channels first: of 100 x 80 x 3 the width and the colours are halved, and 100 x 40 x 1 is returned without a
# word; 3 x 100 x 80, against the documentation, becomes 3 x 50 x 40.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check odak==0.2.7 torch==2.14.1 numpy==2.4.6
v/bin/python - <<'PY' 2>&1 | grep -v INFO
from importlib.metadata import version

import torch
from odak.learn.tools import resize

last = tuple(resize(torch.rand(100, 80, 3), 0.5).shape)
first = tuple(resize(torch.rand(3, 100, 80), 0.5).shape)
print("odak", version("odak"), "half of 100 x 80 x 3:", last, "half of 3 x 100 x 80:", first)
assert last == (100, 40, 1) and first == (3, 50, 40), "the behaviour has changed"
PY
