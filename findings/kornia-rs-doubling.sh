#!/usr/bin/env bash
# A good guess: kornia-rs (image operations in Rust) doubles a picture of bytes by bilinear interpolation as OpenCV does, each value the
# nearest byte. Found: at exactly twice the size averages are rounded up twice, so that the picture becomes 0.7 of a level brighter in
# the mean and up to 1.5, more each time that it is doubled; at three times the size, or one pixel more than twice, it is right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check kornia-rs==0.2.0 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from kornia_rs.imgproc import resize


def bilinear(image, size):
    """Interpolate in float64, pixel centres at halves, borders repeated."""
    for axis, wanted in enumerate(size):
        place = np.clip((np.arange(wanted) + 0.5) * image.shape[axis] / wanted - 0.5, 0, image.shape[axis] - 1)
        low = np.minimum(np.floor(place).astype(int), image.shape[axis] - 2)
        share = (place - low).reshape((-1,) + (1,) * (image.ndim - 1 - axis))
        image = (1 - share) * np.take(image, low, axis) + share * np.take(image, low + 1, axis)
    return image


picture = np.random.default_rng(7).integers(0, 256, (48, 64, 3)).astype(np.uint8)
brighter = {}
for size in ((96, 128), (97, 129), (144, 192)):
    difference = resize(picture, size, "bilinear", False) - bilinear(picture.astype(float), size)
    brighter[size] = round(float(difference.mean()), 2), round(float(difference.max()), 2)
again = picture
for _ in range(3):
    again = resize(again, (2 * again.shape[0], 2 * again.shape[1]), "bilinear", False)
risen = float(again.mean() - picture.mean())
print("kornia-rs", version("kornia-rs"), "brighter by, at most", brighter, "after three doublings", round(risen, 2))
assert 0.6 < brighter[96, 128][0] < 0.9 and 1.2 < brighter[96, 128][1] <= 1.5, "doubling has changed"
assert risen > 1.8, "three doublings have changed"
assert all(abs(brighter[size][0]) < 0.05 and brighter[size][1] < 0.51 for size in ((97, 129), (144, 192))), "others have changed"
PY
