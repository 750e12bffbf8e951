#!/usr/bin/env bash
# A good guess: Pillow turns and moves a 16-bit grey picture (mode I;16) by interpolation as it does one of 8 bits: a plain picture keeps its grey.
# Found: rotate() and transform() with BILINEAR or BICUBIC interpolate its bytes where they should its pixels: a plain 1000 becomes 232, or 3, or
# 117 between two pixels, 256 becomes 0 and 40000 becomes 155 or 64, without a word. NEAREST and resize() are right, and so is everything
# after convert("I"), or "F".
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pillow==13.0.0
v/bin/python - <<'PY'
from importlib.metadata import version

from PIL import Image

print("Pillow", version("pillow"))
half = (1, 0, 0.5, 0, 1, 0)


def middle(picture, method):
    """Return the middle pixel turned by a quarter and a bit, moved by half a pixel, and made larger, and that of resize()."""
    turned = (
        picture.rotate(90.0001, method),
        picture.transform((16, 16), Image.Transform.AFFINE, half, method),
        picture.transform((16, 16), Image.Transform.EXTENT, (4, 4, 12, 12), method),
    )
    return [one.getpixel((8, 8)) for one in (*turned, picture.resize((32, 32), method))]


found = {}
for level in (100, 256, 1000, 40000):
    plain = Image.new("I;16", (16, 16), level)
    for method in (Image.Resampling.NEAREST, Image.Resampling.BILINEAR, Image.Resampling.BICUBIC):
        got = found[level, method.name] = middle(plain, method)
        print(f"a plain {level}, {method.name}: turned, moved, enlarged, by resize()", got)
        assert got[3] == level, "resize: the behaviour has changed"
        assert middle(plain.convert("I"), method)[:3] == [level] * 3, "32 bits: the behaviour has changed"
        assert (got[:3] == [level] * 3) == (method.name == "NEAREST"), "16 bits: the behaviour has changed"
assert found[1000, "BILINEAR"][:2] == [3, 117] and found[256, "BILINEAR"][:2] == [0, 0], "the behaviour has changed"
assert found[40000, "BILINEAR"][:2] == [155, 110], "the behaviour has changed"
PY
