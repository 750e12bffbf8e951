#!/usr/bin/env bash
# A good guess: rawpy's black_level_per_channel is what postprocess() takes off, and a DNG's black level for each column (BlackLevelDeltaH) or
# row (DeltaV), which the format has against stripes, is taken off each. Found: where the black level repeats every 4 x 4 pixels, black_level_per_channel says
# 0 and postprocess() takes off the right ones, so that readings minus what it says keep their pattern. Levels of columns and rows are averaged to one
# number: the stripes stay.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check rawpy==0.28.0 tifffile==2026.3.3 numpy==2.4.6
cat > look.py <<'PY'
import numpy as np
import rawpy
import tifffile

HEIGHT, WIDTH, LIGHT = 64, 96, 1000
ONE = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)
COMMON = [
    (50706, "B", 4, b"\x01\x04\x00\x00", True),  # DNG 1.4
    (50708, "s", 0, "Camera", True),
    (33421, "H", 2, (2, 2), True),  # the mosaic's size and colours
    (33422, "B", 4, b"\x00\x01\x01\x02", True),
    (50717, "I", 1, 65535, True),  # white level
    (50721, "2i", 9, ONE, True),  # colour matrix
    (50728, "2I", 3, (1,) * 6, True),  # neutral
    (50778, "H", 1, 21, True),  # illuminant
    (271, "s", 0, "Maker", True),
    (272, "s", 0, "Camera", True),
]


def rationals(values):
    return tuple(part for value in values for part in (int(value), 1))


def levels(tag, kind, values):
    return (tag, kind, len(values), rationals(values), True)


def look(black, *tags):
    """Return what rawpy says is black, and the range of the developed picture of even light, which should be LIGHT alone."""
    readings = (LIGHT + np.broadcast_to(black, (HEIGHT, WIDTH))).astype(np.uint16)
    tifffile.imwrite("frame.dng", readings, photometric=32803, metadata=None, subfiletype=0, extratags=[*COMMON, *tags])
    with rawpy.imread("frame.dng") as raw:
        assert np.array_equal(raw.raw_image_visible, readings)
        said = raw.black_level_per_channel
        developed = raw.postprocess(
            gamma=(1, 1), no_auto_bright=True, output_bps=16, user_wb=[1, 1, 1, 1], output_color=rawpy.ColorSpace.raw
        )
    return said, int(developed.min()), int(developed.max())


two = np.array([[10, 20], [30, 40]])
four = 10 * np.arange(16).reshape(4, 4)
columns, rows = 10 * (np.arange(WIDTH) % 7), 10 * (np.arange(HEIGHT) % 5)
tiled = lambda tile: np.tile(tile, (HEIGHT // len(tile), WIDTH // len(tile)))
size = lambda tile: (50713, "H", 2, tile.shape, True)
found = {
    "2 x 2": look(tiled(two), size(two), levels(50714, "2I", two.ravel())),
    "4 x 4": look(tiled(four), size(four), levels(50714, "2I", four.ravel())),
    "columns": look(columns, levels(50714, "2I", [0]), levels(50715, "2i", columns)),
    "rows": look(rows[:, None], levels(50714, "2I", [0]), levels(50716, "2i", rows)),
}
print("rawpy", rawpy.__version__, "LibRaw", rawpy.libraw_version, "even light of", LIGHT)
for kind, (said, low, high) in found.items():
    print(f"black by {kind}: black_level_per_channel {said}, developed {low} to {high}")
assert found["2 x 2"] == ([10, 20, 40, 30], LIGHT, LIGHT)
assert found["4 x 4"] == ([0, 0, 0, 0], LIGHT, LIGHT), "the behaviour has changed"
assert found["columns"][2] - found["columns"][1] == 60 and len(set(found["columns"][0])) == 1, "the behaviour has changed"
assert found["rows"][2] - found["rows"][1] == 40 and len(set(found["rows"][0])) == 1, "the behaviour has changed"
PY
v/bin/python look.py
