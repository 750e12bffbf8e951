#!/usr/bin/env bash
# A good guess: hsi2rgb shows the spectra of a cube as one sees them: what reflects red light alone is red, brighter and darker, and counts of a camera
# look as the same spectra between 0 and 1 do, since they are "normalized to the range [0, 1]". Found: each of red, green and blue is
# stretched by its own least and greatest value, so that a picture of reds goes from cyan by grey to red. And counts are stretched
# band by band before: reds and greens have other colours than divided by 4095, and one empty band makes the whole picture NaN.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check hsi2rgb==0.1.1 numpy==2.4.6
v/bin/python -W ignore - <<'PY'
from importlib.metadata import version

import numpy as np
from hsi2rgb import hsi2rgb

bands = np.arange(400, 701, 10)
red, green = np.exp(-(((bands - 620) / 20) ** 2)), np.exp(-(((bands - 530) / 20) ** 2))
brightness = np.linspace(0.1, 1, 12).reshape(3, 4)


def shown(cube):
    return hsi2rgb(cube, wavelength=bands, input_format="HWC", output_format="HWC", gamma=1)


reds = shown(brightness[..., None] * red)
found = [reds[place].round(2).tolist() for place in ((0, 0), (1, 1), (2, 3))]
print("hsi2rgb", version("hsi2rgb"), "the darkest, a middle and the brightest one of a picture of reds:", found)
assert found[0] == [0, 1, 1] and found[2] == [1, 0, 0] and np.ptp(found[1]) < 0.15, "reds: the behaviour has changed"

scene = brightness[..., None] * (0.1 + 0.9 * np.where(np.arange(4)[None, :, None] < 2, red, green))
counts = np.round(4095 * scene)
as_counts, as_shares = shown(counts), shown(counts / 4095)
print("the brightest green of reds and greens, divided by 4095:", as_shares[2, 3].round(2), "as counts:", as_counts[2, 3].round(2), end=" ")
counts[..., 0] = 0
empty = shown(counts)
print("with an empty band:", empty[2, 3])
assert np.abs(as_counts - as_shares).max() > 0.15, "counts: the behaviour has changed"
assert np.isnan(empty).all(), "an empty band: the behaviour has changed"
PY
