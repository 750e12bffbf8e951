#!/usr/bin/env bash
# A good guess: pycolmap's undistort_image() returns the picture of a camera without distortion as it is. Found: of a pinhole it blacks the last row and column. Of a lens whose
# coefficients are 0, as calibrations of good lenses and of pictures already undistorted have, it makes one a pixel smaller and half a pixel aside, each pixel the mean of four:
# a board of black and white pixels becomes one grey, noise has half its deviation. A coefficient of 0.000001 takes two pixels and keeps the rest sharp.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pycolmap==4.2.1 numpy==2.3.5
v/bin/python - <<'PY'
import numpy as np
import pycolmap

board = (np.indices((64, 64)).sum(axis=0) % 2 * 255).astype(np.uint8)
noise = np.random.default_rng(0).integers(1, 256, (480, 640), dtype=np.uint8)


def undistorted(picture, model, *rest):
    height, width = picture.shape
    focal = [500.0, 500.0] if model == "PINHOLE" else [500.0]
    camera = pycolmap.Camera(model=model, width=width, height=height, params=[*focal, width / 2, height / 2, *rest])
    bitmap, other = pycolmap.undistort_image(pycolmap.UndistortCameraOptions(), pycolmap.Bitmap.from_array(picture), camera)
    return bitmap.to_array(), other


pinhole, _ = undistorted(noise, "PINHOLE")
lens, other = undistorted(noise, "SIMPLE_RADIAL", 0.0)
bent, _ = undistorted(noise, "SIMPLE_RADIAL", 1e-6)
grey, _ = undistorted(board, "SIMPLE_RADIAL", 0.0)
print("pycolmap", pycolmap.__version__, "pinhole: last row", set(pinhole[-1].tolist()), "last column", set(pinhole[:, -1].tolist()))
print("a lens of 640 x 480 and k = 0:", (other.width, other.height), "centre", other.params[2:].tolist(), "deviation of noise", lens.std().round(1), "of", noise.std().round(1))
print("its board:", set(grey.ravel().tolist()), "k = 0.000001:", bent.shape[::-1], "deviation", bent.std().round(1))
assert (pinhole[:-1, :-1] == noise[:-1, :-1]).all()
assert not pinhole[-1].any() and not pinhole[:, -1].any(), "the pinhole: the behaviour has changed"
assert lens.shape == (479, 639) and set(grey.ravel().tolist()) == {128}, "the lens: the behaviour has changed"
assert lens.std() < 0.55 * noise.std() and bent.std() > 0.95 * noise.std(), "the lens: the behaviour has changed"
PY
