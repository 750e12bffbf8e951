#!/usr/bin/env bash
# A good guess: OpenCV's COLOR_RGB2XYZ and COLOR_RGB2Lab take the same RGB, and Lab is that of XYZ; scikit-image and the standards take the
# gamma of sRGB off in both. Found: Lab and Luv are of sRGB, XYZ is of linear light: a grey of 0.5 has Y = 0.5 instead of 0.214 and, by
# the formula of Lab from there, a lightness of 76 where COLOR_RGB2Lab says 53. What is averaged, compared or calibrated in its XYZ is
# not light unless the gamma was taken off before; for Lab of linear light there is COLOR_LRGB2Lab.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check opencv-python-headless==5.0.0.93 scikit-image==0.26.0 numpy==2.4.6
v/bin/python - <<'PY'
import cv2
import numpy as np
import skimage
from skimage import color

colours = np.float32([[[0.5, 0.5, 0.5], [0.25, 0.25, 0.25], [0.8, 0.4, 0.1]]])
linear = np.where(colours > 0.04045, ((colours + 0.055) / 1.055) ** 2.4, colours / 12.92).astype(np.float32)
y = {
    "OpenCV": cv2.cvtColor(colours, cv2.COLOR_RGB2XYZ)[0, :, 1],
    "scikit-image": color.rgb2xyz(colours)[0, :, 1],
    "OpenCV, gamma taken off": cv2.cvtColor(linear, cv2.COLOR_RGB2XYZ)[0, :, 1],
}
lightness = {
    "OpenCV": cv2.cvtColor(colours, cv2.COLOR_RGB2Lab)[0, :, 0],
    "OpenCV, Luv": cv2.cvtColor(colours, cv2.COLOR_RGB2Luv)[0, :, 0],
    "scikit-image": color.rgb2lab(colours)[0, :, 0],
    "of OpenCV's Y": 116 * np.cbrt(y["OpenCV"]) - 16,
}
for title, rows in (("Y", y), ("L", lightness)):
    print("opencv", cv2.__version__, "scikit-image", skimage.__version__, title, {name: row.round(3).tolist() for name, row in rows.items()})
assert np.allclose(y["OpenCV"], colours @ [0.212671, 0.715160, 0.072169], atol=1e-3), "XYZ: the behaviour has changed"
assert np.allclose(y["scikit-image"], y["OpenCV, gamma taken off"], atol=1e-3), "XYZ of linear light has changed"
assert np.allclose(lightness["OpenCV"], lightness["scikit-image"], atol=0.3), "Lab: the behaviour has changed"
assert np.allclose(lightness["OpenCV, Luv"], lightness["OpenCV"], atol=0.3), "Luv: the behaviour has changed"
assert lightness["of OpenCV's Y"][0] > 70 > 60 > lightness["OpenCV"][0], "the difference has changed"
PY
