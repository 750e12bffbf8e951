#!/usr/bin/env bash
# A good guess: PiDNG, which makes DNG files of a Raspberry Pi's raw pictures, writes the depths that sensors have, 8 to 16 bits, packed or
# compressed. Found: 14 bits fail whatever the width, 10 bits unless the width is a multiple of four, both with an error of NumPy's shapes;
# and `compress=True`, its lossless JPEG, fails in every Python from 3.10 on. 8, 12 and 16 bits come back from rawpy exactly.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pidng==4.0.9 rawpy==0.28.0 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

import numpy as np
import rawpy
from pidng.core import RAW2DNG, DNGTags, Tag
from pidng.defs import CalibrationIlluminant, CFAPattern, DNGVersion, Orientation, PhotometricInterpretation

rng = np.random.default_rng(0)
UNIT = [[int(row == column), 1] for row in range(3) for column in range(3)]


def kept(bits, width, height=48, compress=False):
    """Write noise of so many bits as DNG and say how it came back."""
    readings = rng.integers(0, 2**bits, (height, width), dtype=np.uint16)
    tags = DNGTags()
    for name, value in {
        "ImageWidth": width, "ImageLength": height, "TileWidth": width, "TileLength": height, "SamplesPerPixel": 1,
        "Orientation": Orientation.Horizontal, "PhotometricInterpretation": PhotometricInterpretation.Color_Filter_Array,
        "BitsPerSample": bits, "CFARepeatPatternDim": [2, 2], "CFAPattern": CFAPattern.RGGB, "BlackLevel": 0,
        "WhiteLevel": 2**bits - 1, "ColorMatrix1": UNIT, "CalibrationIlluminant1": CalibrationIlluminant.D65,
        "AsShotNeutral": [[1, 1]] * 3, "DNGVersion": DNGVersion.V1_4, "DNGBackwardVersion": DNGVersion.V1_2, "Make": "a", "Model": "b",
    }.items():
        tags.set(getattr(Tag, name), value)
    writer = RAW2DNG()
    writer.options(tags, path="", compress=compress)
    try:
        writer.convert(readings.copy(), filename="picture")
    except (ValueError, SystemError) as error:
        return f"{type(error).__name__}: {error}"
    with rawpy.imread("picture.dng") as raw:
        return "exact" if np.array_equal(raw.raw_image_visible, readings) else "changed"


as_expected = []
for bits, width, compress, expected in (
    (8, 64, False, "exact"), (12, 64, False, "exact"), (12, 66, False, "exact"), (16, 66, False, "exact"), (10, 64, False, "exact"),
    (10, 66, False, "ValueError"), (14, 64, False, "ValueError"), (14, 66, False, "ValueError"), (12, 64, True, "SystemError"),
):
    found = kept(bits, width, compress=compress)
    as_expected.append(found.startswith(expected))
    print("PiDNG", version("pidng"), f"{bits} bits, {width} px wide, {'compressed' if compress else 'packed'}: {found}")
assert all(as_expected), "the behaviour has changed"
PY
