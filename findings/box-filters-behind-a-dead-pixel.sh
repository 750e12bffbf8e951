#!/usr/bin/env bash
# A good guess: a box filter of 9 x 9 makes NaN of the 81 places whose mean has a dead pixel (NaN) in it, as a Gaussian of that size does.
# Found: SciPy's uniform_filter and OpenCV's blur keep running sums, which a NaN never leaves: all that lies to the right of it
# and below becomes NaN, of 100 x 100 pixels 7,056; of 3 x 3 OpenCV's three columns from it downwards. OpenCV's filter2D with
# such a kernel goes by Fourier transforms: all 10,000. sepFilter2D and gaussian_filter keep to the 81.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check scipy==1.17.1 numpy==2.4.6 opencv-python-headless==5.0.0.93
v/bin/python - <<'PY'
import cv2
import numpy as np
import scipy
from scipy import ndimage

filters = {
    "SciPy 9 x 9": lambda picture: ndimage.uniform_filter(picture, 9),
    "OpenCV 9 x 9": lambda picture: cv2.blur(picture, (9, 9)),
    "OpenCV 3 x 3": lambda picture: cv2.blur(picture, (3, 3)),
    "sepFilter2D 9 x 9": lambda picture: cv2.sepFilter2D(picture, -1, np.full(9, 1 / 9), np.full(9, 1 / 9)),
    "filter2D 9 x 9": lambda picture: cv2.filter2D(picture, -1, np.full((9, 9), 1 / 81, picture.dtype)),
    "Gaussian 9 x 9": lambda picture: ndimage.gaussian_filter(picture, 2, radius=4),
}
lost = {}
for name, smooth in filters.items():
    picture = np.full((100, 100), 100.0)
    picture[20, 20] = np.nan
    lost[name] = int(np.isnan(smooth(picture)).sum())
print("scipy", scipy.__version__, "opencv", cv2.__version__, "NaN of one NaN", lost)
assert lost["SciPy 9 x 9"] == lost["OpenCV 9 x 9"] == 84 * 84, "9 x 9: the behaviour has changed"
assert lost["OpenCV 3 x 3"] > 200, "3 x 3: the behaviour has changed"
assert lost["filter2D 9 x 9"] == 10_000, "filter2D: the behaviour has changed"
assert lost["sepFilter2D 9 x 9"] == lost["Gaussian 9 x 9"] == 81, "convolutions: the behaviour has changed"
PY
