#!/usr/bin/env bash
# A good guess: imagecodecs either refuses a 16-bit picture as JPEG, which has 8 or 12 bits, or scales it to 12. Found: it encodes the levels as
# they are, without a word, and those from 4096 on become others: in colour they come round (4096 is black, 5000 is 904, 8292 is 100), in grey
# 4096 and 5000 are held at 4095, but 8292 is 100 and 65535 is black. Seen in pictures of one level each; those of up to 4095 come back
# as they were, and with lossless=True and bitspersample=16 all do.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check imagecodecs==2026.3.6 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import imagecodecs
import numpy as np

levels = [100, 4095, 4096, 5000, 8292, 65535]


def read_back(shape, **how):
    pictures = [np.full(shape, level, np.uint16) for level in levels]
    return [int(imagecodecs.jpeg_decode(imagecodecs.jpeg_encode(picture, **how)).flat[0]) for picture in pictures]


grey, colour = read_back((16, 16), level=100), read_back((16, 16, 3), level=100)
lossless = read_back((16, 16), lossless=True, bitspersample=16)
print("imagecodecs", version("imagecodecs"), "levels", levels, "grey", grey, "colour", colour, "lossless", lossless)
assert grey == [100, 4095, 4095, 4095, 100, 0], "grey: the behaviour has changed"
assert colour == [100, 4095, 0, 904, 100, 4095], "colour: the behaviour has changed"
assert lossless == levels, "without loss: the behaviour has changed"
PY
