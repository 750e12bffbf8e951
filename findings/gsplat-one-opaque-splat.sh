#!/usr/bin/env bash
# gsplat's `export_splats` leaves out splats that are not finite. A good guess: a splat that is fully opaque, whose logit of opacity is
# infinite (SPZ's 255 gives one), is left out, or is kept as opaque. Found: it takes all others with it: the file has no splat, for each
# format, without a word, whereas a splat whose scale is infinite costs only itself.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check gsplat==1.5.3 torch==2.14.1 numpy==2.4.6
v/bin/python - <<'PY' 2>errors || { cat errors; exit 1; }
import re
from importlib.metadata import version

import torch
from gsplat.exporter import export_splats


def written(opacity, log_scale):
    """Return how many splats a PLY file has, of 100 of which the first is special."""
    torch.manual_seed(0)
    opacities, scales = torch.zeros(100), torch.full((100, 3), -3.0)
    opacities[0], scales[0] = torch.logit(torch.tensor(opacity)), log_scale
    file = export_splats(torch.rand(100, 3), scales, torch.rand(100, 4), opacities, torch.rand(100, 1, 3), torch.zeros(100, 0, 3))
    return int(re.search(rb"element vertex (\d+)", file)[1])


counts = written(0.5, -3.0), written(0.99, -3.0), written(1.0, -3.0), written(0.5, float("inf"))
print("gsplat", version("gsplat"), "of 100 splats are written:", counts, "(all usual, one of opacity 0.99, one of opacity 1, one of infinite scale)")
assert counts == (100, 100, 0, 99), "the behaviour has changed"
PY
