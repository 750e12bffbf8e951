#!/usr/bin/env bash
# A good guess: torchmetrics' MeanSquaredError and MeanAbsoluteError of two pictures of bytes are those of the numbers, as its PSNR of
# the same two pictures is. Found: they subtract, take the absolute value and square in bytes: of pictures that differ by 10 levels in
# the mean, and of others that differ by 77, the absolute error is 123 and 127, the squared one 71 and 106 instead of 161 and 9226.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check torchmetrics==1.9.0 torch==2.14.1 numpy==2.4.6
v/bin/python -W ignore - <<'PY'
import torch
import torchmetrics
from torchmetrics.functional.image import peak_signal_noise_ratio

generator = torch.Generator().manual_seed(0)
picture = torch.randint(0, 256, (3, 64, 64), generator=generator, dtype=torch.uint8)


def noisy(sigma):
    noise = sigma * torch.randn(picture.shape, generator=generator)
    return (picture + noise).round().clamp(0, 255).to(torch.uint8)


seen = {}
for sigma in (13, 150):
    other = noisy(sigma)
    truth = picture.double() - other.double()
    pairs = {"bytes": (other.flatten(), picture.flatten()), "float": (other.flatten().double(), picture.flatten().double())}
    squared = {name: round(float(torchmetrics.MeanSquaredError()(*pair)), 1) for name, pair in pairs.items()}
    absolute = {name: round(float(torchmetrics.MeanAbsoluteError()(*pair)), 1) for name, pair in pairs.items()}
    psnr = float(peak_signal_noise_ratio(other, picture, data_range=255)), float(10 * torch.log10(255**2 / (truth**2).mean()))
    seen[sigma] = squared, absolute
    print("torchmetrics", torchmetrics.__version__, "noise", sigma, "MSE", squared, "MAE", absolute, "PSNR, right", [round(x, 3) for x in psnr])
    assert abs(absolute["float"] - float(truth.abs().mean())) < 0.06 and abs(psnr[0] - psnr[1]) < 0.01, "what is right has changed"
assert seen[13][1]["bytes"] > 100 > 12 > seen[13][1]["float"], "absolute error: the behaviour has changed"
assert seen[13][0]["bytes"] < 100 < seen[13][0]["float"] and seen[150][0]["bytes"] < 200, "squared error: the behaviour has changed"
assert seen[150][1]["bytes"] > 100 > seen[150][1]["float"], "large errors: the behaviour has changed"
PY
