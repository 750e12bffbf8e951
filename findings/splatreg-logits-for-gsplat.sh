#!/usr/bin/env bash
# A good guess: of a scene that splatreg loads from a PLY file, to_gsplat(), which its page hands to gsplat's rasterization as it is, has what gsplat
# takes: lengths and opacities from 0 to 1; and save_ply() of a scene by from_gsplat() undoes both. Found: lengths are converted, opacities are not: a
# splat of 0.95 is handed over as 2.94, one of 0.1 as -2.2, and 0.95 given by gsplat is stored as a logit, 0.72 in every viewer.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check splatreg==1.5.0 torch==2.13.0 numpy==2.4.6
OMP_NUM_THREADS=1 v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import torch
from splatreg import io

opacity = torch.tensor([0.95, 0.1])
one = torch.tensor([[1.0, 0, 0, 0]]).repeat(2, 1)
scene = io.from_gsplat(torch.zeros(2, 3), one, torch.full((2, 3), 0.01), opacity.logit(), torch.full((2, 3), 0.7))
io.save_ply(scene, "scene.ply")
loaded = io.load_ply("scene.ply", device="cpu")
bundle = io.to_gsplat(loaded)
io.save_ply(io.from_gsplat(torch.zeros(2, 3), one, torch.full((2, 3), 0.01), opacity, torch.full((2, 3), 0.7)), "again.ply")
again = io.load_ply("again.ply", device="cpu")
viewed = again.opacities.sigmoid()
print("splatreg", version("splatreg"), "a file of opacities", opacity.tolist(), "is handed to gsplat as", bundle["opacities"].tolist(), "with lengths", bundle["scales"][0].tolist())
print("opacities", opacity.tolist(), "of gsplat are in a file", again.opacities.tolist(), ", in a viewer", viewed.tolist(), "with lengths", again.scales.exp()[0].tolist())
assert torch.allclose(bundle["scales"], torch.tensor(0.01)) and torch.allclose(again.scales.exp(), torch.tensor(0.01))
assert torch.allclose(bundle["opacities"], opacity.logit(), atol=1e-4), "to_gsplat: the behaviour has changed"
assert abs(float(viewed[0]) - 0.721) < 1e-3, "from_gsplat: the behaviour has changed"
PY
