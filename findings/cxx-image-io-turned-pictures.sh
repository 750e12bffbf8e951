#!/usr/bin/env bash
# A good guess: cxx-image-io, which reads and writes cameras' raw and other pictures as NumPy arrays, writes a picture that was turned by NumPy as it
# looks. Found: it writes the memory of an array row by row, whatever its strides: a transposed picture, and every second column of one,
# come back scrambled, in the right shape and without a word; copies of the same are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check cxx-image-io==1.1.7 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version
from pathlib import Path

import numpy as np
from cxx_image_io import ImageLayout, ImageMetadata, ImageWriter, PixelType, read_image, write_image

print("cxx-image-io", version("cxx-image-io"))


def back(picture):
    """Return a grey picture of 16 bits, written and read."""
    about = ImageMetadata()
    about.fileInfo.pixelType, about.fileInfo.imageLayout, about.fileInfo.pixelPrecision = PixelType.GRAYSCALE, ImageLayout.PLANAR, 16
    write_image(Path("picture.png"), picture, ImageWriter.Options(about))
    return np.asarray(read_image(Path("picture.png"))[0])


picture = np.arange(24, dtype=np.uint16).reshape(4, 6)
kept = {}
for name, view in (("as it is", picture), ("transposed", picture.T), ("every second column", picture[:, ::2])):
    read = back(view)
    kept[name] = np.array_equal(read, view)
    print(name, "has the first row", view[0], "and comes back as", read[0], read.shape)
    assert read.shape == view.shape and np.array_equal(back(np.ascontiguousarray(view)), view), "copies: the behaviour has changed"
assert kept == {"as it is": True, "transposed": False, "every second column": False}, "views: the behaviour has changed"
PY
