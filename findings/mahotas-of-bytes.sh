#!/usr/bin/env bash
# A good guess: mahotas' convolution of an 8-bit picture with a kernel of ninths is its mean, as `mean_filter` gives it, and `labeled_sum` adds up
# what lies under each label. Found: `convolve` makes whole numbers of the kernel, in the picture's own type and without a word, so that
# ninths make it black and 2.7 is 2; `labeled_sum` comes round at 256 in 8 bits and at 65,536 in 16, and of booleans is True or False.
# Of floats both are right, and `convolve` is a correlation: a kernel of one on its upper left moves the picture down and to the right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check mahotas==1.4.19 numpy==2.4.6 scipy==1.17.1
v/bin/python - <<'PY'
import mahotas
import numpy as np
from scipy import ndimage

picture = np.full((40, 40), 50, np.uint8)
box, centre, corner = np.full((3, 3), 1 / 9), np.zeros((3, 3)), np.zeros((3, 3))
centre[1, 1], corner[0, 0] = 2.7, 1
means = [int(one.max()) for one in (mahotas.convolve(picture, box), mahotas.mean_filter(picture, np.ones((3, 3))))]
factor = int(mahotas.convolve(picture, centre)[20, 20])
floats = float(mahotas.convolve(picture.astype(float), box)[20, 20])
labels = np.ones(picture.shape, np.int32)
sums = [mahotas.labeled_sum(picture.astype(kind), labels)[1].item() for kind in (np.uint8, np.uint16, bool, float)]
point = np.zeros((9, 9))
point[4, 4] = 1
places = [tuple(int(i) for i in np.argwhere(convolve(point, corner) == 1)[0]) for convolve in (mahotas.convolve, ndimage.convolve)]
print("mahotas", mahotas.__version__, "50 by ninths, by mean_filter", means, "50 by 2.7", factor, "of floats", round(floats, 6))
print("sums of 80,000 in 8 and 16 bits, of a mask and of floats", sums, "a point at (4, 4) by a corner and by SciPy's", places)
assert means == [0, 50] and factor == 100 and abs(floats - 50) < 1e-9, "kernels: the behaviour has changed"
assert sums == [80_000 % 256, 80_000 % 65_536, True, 80_000], "sums: the behaviour has changed"
assert places == [(5, 5), (3, 3)], "the kernel's side: the behaviour has changed"
PY
