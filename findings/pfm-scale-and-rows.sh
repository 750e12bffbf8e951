#!/usr/bin/env bash
# A good guess: a PFM depth map means one thing: rows from the bottom, and a scale of which only the sign counts, or that multiplies.
# Found: OpenImageIO reads rows in the file's order, so that even what it wrote itself (from the bottom) comes back upside down, until it is
# opened with settings, even empty ones; it multiplies by the scale. OpenCV divides by it: of 1 with scale 2 one makes 2, the other 0.5.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check OpenImageIO==3.2.2.0 opencv-python-headless==5.0.0.93 numpy==2.4.6
v/bin/python - <<'PY'
import cv2
import numpy as np
import OpenImageIO as oiio

rows = np.array([[1.0], [2.0], [3.0]], np.float32)  # from the top
spec = oiio.ImageSpec(1, 3, 1, "float")
out = oiio.ImageOutput.create("own.pfm")
out.open("own.pfm", spec)
out.write_image(rows[..., None])
out.close()


def by_oiio(name, *settings):
    return np.asarray(oiio.ImageInput.open(name, *settings).read_image()).ravel().tolist()


with open("scaled.pfm", "wb") as file:
    file.write(b"Pf\n1 3\n-2.0\n" + rows[::-1].astype("<f4").tobytes())
empty = oiio.ImageSpec()
own, asked, own_cv = by_oiio("own.pfm"), by_oiio("own.pfm", empty), cv2.imread("own.pfm", -1).ravel().tolist()
scaled, scaled_cv = by_oiio("scaled.pfm", empty), cv2.imread("scaled.pfm", -1).ravel().tolist()
print("OpenImageIO", oiio.VERSION_STRING, own, "with settings", asked, "scale 2", scaled, "OpenCV", cv2.__version__, own_cv, "scale 2", scaled_cv)
assert (own, asked, own_cv) == ([3, 2, 1], [1, 2, 3], [1, 2, 3]), "the behaviour has changed"
assert (scaled, scaled_cv) == ([2, 4, 6], [0.5, 1, 1.5]), "the behaviour has changed"
PY
