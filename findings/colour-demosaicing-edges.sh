#!/usr/bin/env bash
# A good guess: demosaicing a picture of one colour gives that colour everywhere, since every method is a mean of neighbours whose weights sum
# to one. Found: colour-demosaicing's bilinear and Malvar's methods mirror the mosaic at its borders about the pixels' edges, which moves it
# by one pixel and exchanges the colours there: blue is half as bright in the first row and column and 1.5 times in the last, 2.25 times in
# the corner, beyond full scale. Menon's method, which pads otherwise, keeps the colour. Crop two pixels, or pad by two whole cells first.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check colour-demosaicing==0.2.7 colour-science==0.4.7 numpy==2.4.6 scipy==1.17.1
v/bin/python - 2>/dev/null <<'PY'
from importlib.metadata import version

import colour_demosaicing as cd
import numpy as np

colour = np.array([0.2, 0.5, 0.8])
picture = np.ones((8, 8, 3)) * colour
mosaic = cd.mosaicing_CFA_Bayer(picture, "RGGB")
bilinear = cd.demosaicing_CFA_Bayer_bilinear(mosaic, "RGGB") / colour
print("colour-demosaicing", version("colour-demosaicing"), "bilinear, blue as a multiple of what it was:")
print(np.round(bilinear[..., 2], 2))
assert np.allclose(bilinear[1:-1, 1:-1], 1), "the behaviour has changed"
assert np.isclose(bilinear[0, 4, 2], 0.5) and np.isclose(bilinear[-1, 4, 2], 1.5), "the behaviour has changed"
assert np.isclose(bilinear[-1, -1, 2], 2.25) and np.isclose(bilinear[0, 0, 2], 0.25), "the behaviour has changed"
malvar = cd.demosaicing_CFA_Bayer_Malvar2004(mosaic, "RGGB") / colour
menon = cd.demosaicing_CFA_Bayer_Menon2007(mosaic, "RGGB") / colour
print(f"Malvar: {malvar.min():.2f} to {malvar.max():.2f} times; Menon: {menon.min():.2f} to {menon.max():.2f} times")
assert malvar.min() < 0.6 and malvar.max() > 1.1, "the behaviour has changed"
assert np.allclose(menon, 1), "the behaviour has changed"
PY
