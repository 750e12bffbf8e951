#!/usr/bin/env bash
# A good guess: of scikit-image's orders of interpolation a higher one is more exact, `warp` with order=3 is SciPy's spline of order 3,
# and a motion given as a function is the same as one given as a matrix. Found: order 3 of a matrix is a convolution by
# Catmull and Rom's cubic, which errs ten times as much as the spline and twice as much as order 2 (which scikit-image warns of); the
# same motion as a function of coordinates, and order 4, are by the spline.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check scikit-image==0.26.0 scipy==1.17.1 numpy==2.4.6
v/bin/python -W ignore - <<'PY'
import numpy as np
import skimage
from scipy import ndimage
from skimage.transform import AffineTransform, warp


def spot(row, column, sigma=2.0):
    rows, columns = np.indices((41, 41))
    return np.exp(-((rows - 20 - row) ** 2 + (columns - 20 - column) ** 2) / (2 * sigma**2))


matrix = AffineTransform(translation=(0.3, 0.1))
errors = {}
for order in (1, 2, 3, 4):
    seen = {
        "matrix": warp(spot(0, 0), matrix, order=order),
        "function": warp(spot(0, 0), lambda places: places + [0.3, 0.1], order=order),
        "SciPy": ndimage.shift(spot(0, 0), (-0.1, -0.3), order=order),
    }
    errors[order] = {name: round(float(abs(picture - spot(-0.1, -0.3)).max()), 5) for name, picture in seen.items()}
    print("scikit-image", skimage.__version__, "order", order, "largest error of a spot of height 1, moved", errors[order])
for order in (1, 2, 4):
    assert len(set(errors[order].values())) == 1, "other orders: the behaviour has changed"
third = errors[3]
assert third["function"] == third["SciPy"] < third["matrix"] / 5, "order 3: the behaviour has changed"
assert third["matrix"] > 2 * errors[2]["matrix"] > 2 * errors[4]["matrix"], "orders 2 and 4: the behaviour has changed"
PY
