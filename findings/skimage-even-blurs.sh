#!/usr/bin/env bash
# A good guess: scikit-image's deconvolutions, `richardson_lucy` and `wiener`, put what they restore into one place, given the same blurred
# picture and the same blur. Found: where the blur has an even size the two lie a pixel apart on both axes. The middle of a blur of 6 x 6
# is its element 2 for one (as in SciPy's signal functions) and its element 3 for the other (as in its ndimage). Odd sizes agree.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check scikit-image==0.26.0 scipy==1.17.1 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
from scipy import ndimage, signal
from skimage.restoration import richardson_lucy, wiener

box = np.zeros((64, 64))
box[20:30, 30:45] = 1
scene = ndimage.gaussian_filter(box, 1)


def moved(picture):
    """How far the centre of mass lies from the scene's, in rows and columns."""
    return np.subtract(ndimage.center_of_mass(np.clip(picture, 0, None)), ndimage.center_of_mass(scene))


found = {}
for size in (5, 6):
    blur = np.full((size, size), 1 / size**2)
    blurred = {"ndimage.convolve": ndimage.convolve(scene, blur), "signal.fftconvolve": signal.fftconvolve(scene, blur, "same")}
    for name, picture in blurred.items():
        found[size, name] = moved(richardson_lucy(picture, blur, 30)), moved(wiener(picture, blur, 1e-3, clip=False))
        lucy, hunt = found[size, name]
        print("scikit-image", version("scikit-image"), f"{size} x {size} by {name}: richardson_lucy moved by", lucy.round(2), "wiener by", hunt.round(2))
for name in ("ndimage.convolve", "signal.fftconvolve"):
    assert np.abs(found[5, name]).max() < 0.1, "odd sizes: the behaviour has changed"
    lucy, hunt = found[6, name]
    assert np.all((0.8 < hunt - lucy) & (hunt - lucy < 1.2)), "the behaviour has changed"
assert np.abs(found[6, "signal.fftconvolve"][0]).max() < 0.1 and np.abs(found[6, "ndimage.convolve"][1]).max() < 0.2, "which is right has changed"
PY
