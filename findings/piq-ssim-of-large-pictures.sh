#!/usr/bin/env bash
# A good guess: SSIM of one pair of pictures is the same number in piq and in scikit-image once window, sigma and range agree, whatever the
# size. Found: up to 383 px a side it is, to 1e-5; from 384 on piq first averages the pictures down (`downsample=True`), twofold at 384
# to 639, and noise counts far less: 0.45 becomes 0.83 or so. Tables that mix 256 and 512 px, or piq and others, compare two measures.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check piq==0.8.0 torch==2.14.1 torchvision==0.29.1 scikit-image==0.26.0 numpy==2.4.6
v/bin/python - <<'PY'
import numpy as np
import piq
import torch
from skimage.filters import gaussian
from skimage.metrics import structural_similarity

rng = np.random.default_rng(0)
differences = {}
for side in (256, 383, 384, 512):
    truth = gaussian(rng.random((side, side)), 3)
    truth = 0.2 + 0.6 * (truth - truth.min()) / np.ptp(truth)
    noisy = np.clip(truth + 0.05 * rng.standard_normal(truth.shape), 0, 1)
    usual = structural_similarity(truth, noisy, data_range=1, gaussian_weights=True, sigma=1.5, use_sample_covariance=False)
    pair = [torch.tensor(picture)[None, None] for picture in (truth, noisy)]
    found, whole = (piq.ssim(*pair, data_range=1.0, downsample=down).item() for down in (True, False))
    differences[side] = found - usual
    print("piq", piq.__version__, f"{side} px: scikit-image {usual:.3f}, piq {found:.3f}, without downsampling {whole:.3f}")
    assert abs(whole - usual) < 1e-4, "the behaviour has changed"
small, large = (abs(differences[256]) + abs(differences[383])), min(differences[384], differences[512])
assert small < 1e-4 and large > 0.2, "the behaviour has changed"
PY
