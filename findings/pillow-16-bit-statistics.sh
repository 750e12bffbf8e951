#!/usr/bin/env bash
# A good guess: Pillow's ImageStat gives the mean, the median and the deviation of a picture's pixels in each mode, or refuses one. Found: of a picture
# whose pixels are 32-bit whole numbers or floats it gives those of its stretch to 0..255: all ramps have the mean 127, whether they
# go from 1000 to 5000 or from 0 to 1. Of 16 bits it counts each pixel's two bytes: a plain 1000 has the mean 117.5, and 256 has
# 0.5. `extrema` says (0, 255) of the former, and histogram() has 256 bins; getextrema() alone is right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pillow==13.0.0
v/bin/python - <<'PY'
from importlib.metadata import version

from PIL import Image, ImageStat

print("Pillow", version("pillow"))
found = {}
for least, most, modes in ((1000, 5000, ("I;16", "I", "F")), (0, 1, ("F",))):
    for mode in modes:
        picture = Image.new(mode, (101, 10))
        for place in range(1010):
            value = least + (most - least) * (place % 101) / 100
            picture.putpixel((place % 101, place // 101), value if mode == "F" else int(value))
        said = ImageStat.Stat(picture)
        found[most, mode] = said.mean[0]
        print(f"{mode} {least}..{most}: mean", said.mean, "deviation", said.stddev, "extrema", said.extrema, end=" ")
        print("getextrema()", picture.getextrema(), "bins", len(picture.histogram()))
        assert picture.getextrema() == (least, most) and len(picture.histogram()) == 256, "the behaviour has changed"
        assert said.mean[0] < 128 and said.stddev[0] < 100, "the behaviour has changed"
for number in ((5000, "I"), (5000, "F"), (1, "F")):
    assert 126.5 < found[number] < 127.6, "32 bits: the behaviour has changed"
plain = {level: ImageStat.Stat(Image.new("I;16", (16, 16), level)).mean[0] for level in (100, 256, 1000, 40000)}
print("means of plain pictures of 16 bits:", plain)
assert plain == {100: 50.0, 256: 0.5, 1000: 117.5, 40000: 110.0}, "16 bits: the behaviour has changed"
assert ImageStat.Stat(Image.new("L", (16, 16), 100)).mean == [100], "8 bits: the behaviour has changed"
PY
