#!/usr/bin/env bash
# A good guess: sewar's uqi() is Wang and Bovik's universal image quality index: 1 for a pair that is the same, 0 for two that have nothing in
# common, -1 for a picture and its negative. Found: it puts means over the window where the formula that it was written from has sums, so the
# squares of means outweigh what differs by the window's 64 pixels: two pictures of independent random bytes have 0.95, a picture and its
# negative 0.90, a picture and plain grey 0.98, and one with noise of 20 levels 0.99 where 0.80 is right. Published as a measure of fusion.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check sewar==0.4.10 numpy==2.4.6 scipy==1.17.1
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from scipy.ndimage import uniform_filter
from sewar.full_ref import uqi


def index(first, second, size=8):
    """Wang and Bovik, A universal image quality index (2002), equation 2, averaged over windows."""
    first, second = first.astype(float), second.astype(float)
    mean_1, mean_2 = uniform_filter(first, size), uniform_filter(second, size)
    variances = uniform_filter(first**2, size) - mean_1**2 + uniform_filter(second**2, size) - mean_2**2
    together = uniform_filter(first * second, size) - mean_1 * mean_2
    values = 4 * together * mean_1 * mean_2 / (variances * (mean_1**2 + mean_2**2))
    return float(values[size // 2 : -size // 2, size // 2 : -size // 2].mean())


generator = np.random.default_rng(0)
picture = generator.integers(80, 180, (256, 256)).astype(np.uint8)
others = {
    "the same": picture,
    "unrelated": generator.integers(80, 180, (256, 256)).astype(np.uint8),
    "negative": 255 - picture,
    "noisy": np.clip(picture + generator.normal(0, 20, picture.shape), 0, 255).astype(np.uint8),
    "plain": np.full_like(picture, 130),
}
found = {}
for name, other in others.items():
    found[name] = float(uqi(picture, other)), index(picture, other)
    print(f"sewar {version('sewar')} uqi, {name}: {found[name][0]:.3f}; by the formula {found[name][1]:.3f}")
assert np.allclose(found["the same"], 1) and abs(found["unrelated"][1]) < 0.02 and found["negative"][1] < -0.9
assert found["unrelated"][0] > 0.9 and found["negative"][0] > 0.85 and found["plain"][0] > 0.95, "the behaviour has changed"
assert found["noisy"][0] > 0.98 and found["noisy"][1] < 0.85, "the behaviour has changed"
PY
