#!/usr/bin/env bash
# A good guess: `antialias` of PyTorch's interpolate matters where a picture becomes smaller, and a picture of bytes becomes what the same
# in floating point becomes, rounded. Found: enlarged by "bicubic" it takes another kernel, a = -0.5 as Pillow instead of -0.75 as
# OpenCV: results differ by 8 % of the range, and a ramp is kept by one alone ("bilinear": no difference). And bytes are rounded up after
# each axis: halved by "bilinear" without antialias they are half a level too bright in the mean and up to one.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check torch==2.14.1 numpy==2.4.6
v/bin/python -W ignore - <<'PY'
import torch
from torch.nn.functional import interpolate

generator = torch.Generator().manual_seed(0)
noise = torch.rand(1, 1, 64, 64, generator=generator, dtype=torch.float64)
ramp = torch.arange(64, dtype=torch.float64).repeat(1, 1, 64, 1)
place = (torch.arange(192, dtype=torch.float64) + 0.5) / 3 - 0.5
apart, off = {}, {}
for mode in ("bilinear", "bicubic"):
    one, two = (interpolate(noise, size=(128, 128), mode=mode, antialias=antialias) for antialias in (False, True))
    apart[mode] = round(float(abs(one - two).max()), 3)
    rows = [interpolate(ramp, size=(64, 192), mode=mode, antialias=antialias)[0, 0, 32] for antialias in (False, True)]
    off[mode] = [round(float(abs(row - place)[60:132].max()), 3) for row in rows]
counts = torch.randint(0, 256, (1, 3, 64, 64), generator=generator, dtype=torch.uint8)
brighter = {}
for size in (32, 128):
    difference = interpolate(counts, size=(size, size), mode="bilinear") - interpolate(counts.double(), size=(size, size), mode="bilinear")
    brighter[size] = round(float(difference.mean()), 2), round(float(difference.max()), 2)
print("torch", torch.__version__, "enlarged twice, with and without antialias apart by", apart, "of a range of 1")
print("a ramp three times as large is off by, without and with it", off)
print("bytes of 64 px to 32 and to 128 are brighter by, at most", brighter)
assert apart["bilinear"] == 0 and apart["bicubic"] > 0.05, "enlarging: the behaviour has changed"
assert off["bicubic"][0] > 0.03 and off["bicubic"][1] == 0 and off["bilinear"] == [0, 0], "ramps: the behaviour has changed"
assert 0.45 < brighter[32][0] < 0.55 and brighter[32][1] == 1 and 0.2 < brighter[128][0] < 0.3, "bytes: the behaviour has changed"
PY
