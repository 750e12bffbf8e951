#!/usr/bin/env bash
# A good guess: visual information fidelity (VIF) compares two pictures alike whether both lie in 0..1 or in 0..255, or there is a parameter
# for the range, as for SSIM. Found: in sewar and torchmetrics neither: the noise of the eye is the variance 2 of grey values up to 255,
# beside which next to nothing in 0..1 is seen. One noisy picture has 0.35 in 8 bits, 0.12 in 16 bits and 0.97, nearly perfect, in 0..1.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check torchmetrics==1.9.0 torch==2.14.1 numpy==2.4.6 sewar==0.4.10 scipy==1.17.1
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import sewar
import torch
from scipy.ndimage import gaussian_filter
from torchmetrics.functional.image import visual_information_fidelity

rng = np.random.default_rng(0)
truth = gaussian_filter(rng.random((64, 64)), 2)
truth = (truth - truth.min()) / np.ptp(truth)
noisy = np.clip(truth + 0.05 * rng.standard_normal(truth.shape), 0, 1)
found = {}
for scale in (1, 255, 65535):
    pair = [torch.tensor(scale * picture)[None, None] for picture in (truth, noisy)]
    found[scale] = visual_information_fidelity(pair[1], pair[0]).item(), sewar.vifp(scale * truth, scale * noisy)
    print("values to", scale, f"torchmetrics {version('torchmetrics')}: {found[scale][0]:.2f}, sewar {version('sewar')}: {found[scale][1]:.2f}")
assert min(found[1]) > 0.9 and max(found[65535]) < 0.2, "the behaviour has changed"
assert all(0.3 < value < 0.4 for value in found[255]), "the behaviour has changed"
PY
