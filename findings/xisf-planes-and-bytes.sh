#!/usr/bin/env bash
# A good guess: xisf reads astronomy's XISF files as their headers say, or refuses them: upper byte first where byteOrder is "big", and not at all
# where pixelStorage is "Normal", colours side by side, of which its page says that they are not supported; and a picture of three planes, the order in which
# FITS and XISF itself hold colours, it writes as one. Found: neither attribute is looked at: 1 is read as 256, and the colours of neighbours are
# mixed, without a word. And of 3 planes of 4 rows by 5 columns it makes 5 planes of 4 rows by 3 columns, "RGB". Colours last, or one
# plane, the lower byte first, are right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --no-compile --disable-pip-version-check --no-deps xisf==0.9.6 numpy==2.4.6 lz4==4.4.5 zstandard==0.25.0
v/bin/python -W ignore - <<'PY'
from importlib.metadata import version
from pathlib import Path

import numpy as np
from xisf import XISF


def write(name, shape, values, more=""):
    """Write a file of 16 bits; of the order of its values `more` tells."""
    rows, columns, planes = shape
    space = "RGB" if planes == 3 else "Gray"
    header = f"""<?xml version="1.0" encoding="UTF-8"?><xisf version="1.0" xmlns="{XISF._xml_ns["xisf"]}"><Image geometry="{columns}:{rows}:{planes}" sampleFormat="UInt16" colorSpace="{space}" {more} location="attachment:4096:{values.nbytes}"/><Metadata/></xisf>""".encode()
    Path(name).write_bytes((b"XISF0100" + len(header).to_bytes(4, "little") + bytes(4) + header).ljust(4096, b"\0") + values.tobytes())


grey = np.arange(20, dtype="<u2").reshape(4, 5, 1)
colour = np.arange(60, dtype="<u2").reshape(4, 5, 3)
planes = np.ascontiguousarray(np.moveaxis(colour, -1, 0))
write("little.xisf", grey.shape, grey)
write("big.xisf", grey.shape, grey.astype(">u2"), 'byteOrder="big"')
write("planar.xisf", colour.shape, planes)
write("normal.xisf", colour.shape, colour, 'pixelStorage="Normal"')
XISF.write("last.xisf", colour)
XISF.write("first.xisf", planes)
read = {name: XISF(f"{name}.xisf").read_image(0) for name in ("little", "big", "planar", "normal", "last", "first")}
print("xisf", version("xisf"), "first values: lower byte first", read["little"].ravel()[:4].tolist(), "; upper byte first", read["big"].ravel()[:4].tolist())
print("first pixel, which is", colour[0, 0].tolist(), ": planes", read["planar"][0, 0].tolist(), "; colours side by side", read["normal"][0, 0].tolist())
print("written: colours last", read["last"].shape, "; planes first", read["first"].shape, XISF("first.xisf").get_images_metadata()[0]["geometry"])
assert np.array_equal(read["little"], grey) and np.array_equal(read["planar"], colour) and np.array_equal(read["last"], colour)
assert np.array_equal(read["big"], grey.byteswap()), "bytes: the behaviour has changed"
assert read["normal"].shape == colour.shape and read["normal"][0, 0].tolist() == [0, 20, 40], "storage: the behaviour has changed"
assert read["first"].shape == (4, 3, 5), "planes: the behaviour has changed"
PY
