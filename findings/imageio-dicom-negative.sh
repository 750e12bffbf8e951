#!/usr/bin/env bash
# A good guess: imageio reads a DICOM picture of unsigned 8 or 16 bits, whose rescale slope is 1 and intercept 0, as what it is: 200 is 200 and
# 40000 is 40000. Found: where a file has a slope or intercept at all, its own reader, the first in its order for .dcm, chooses among
# signed types alone, by the largest value, with the limits of unsigned ones: 128 to 255 become -128 to -1, 40000 becomes -25536. Without
# slope and intercept in the file all is right.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check --no-deps imageio==2.38.1 numpy==2.4.6 pillow==13.0.0
v/bin/python - <<'PY'
import struct

import imageio
import imageio.v3 as iio
import numpy as np


def element(group, number, kind, content):
    """Return an element of explicit kind, the lower bytes first."""
    content = content.encode() if isinstance(content, str) else content
    content += (b" " if kind in (b"DS", b"CS", b"LO") else b"\0") * (len(content) % 2)
    size = struct.pack("<HI", 0, len(content)) if kind in (b"OB", b"OW") else struct.pack("<H", len(content))
    return struct.pack("<HH", group, number) + kind + size + content


def read(picture, rescaled):
    """Write a picture of unsigned numbers as a secondary capture, with slope 1 and intercept 0 if asked, and return what is read."""
    bits = 8 * picture.itemsize
    short = [struct.pack("<H", value) for value in (1, *picture.shape, bits, bits, bits - 1, 0)]
    meta = b"".join(
        element(2, number, kind, content)
        for number, kind, content in (
            (1, b"OB", b"\0\1"),
            (2, b"UI", "1.2.840.10008.5.1.4.1.1.7"),
            (3, b"UI", "1.2.3.4"),
            (16, b"UI", "1.2.840.10008.1.2.1"),
        )
    )
    body = element(8, 0x16, b"UI", "1.2.840.10008.5.1.4.1.1.7") + element(8, 0x18, b"UI", "1.2.3.4")
    body += element(8, 0x60, b"CS", "OT") + element(0x20, 0xD, b"UI", "1.2.3") + element(0x20, 0xE, b"UI", "1.2.3.1")
    body += element(0x20, 0x13, b"IS", "1 ") + element(0x28, 2, b"US", short[0]) + element(0x28, 4, b"CS", "MONOCHROME2")
    for number, value in zip((0x10, 0x11, 0x100, 0x101, 0x102, 0x103), short[1:], strict=True):
        body += element(0x28, number, b"US", value)
    if rescaled:
        body += element(0x28, 0x1052, b"DS", "0") + element(0x28, 0x1053, b"DS", "1")
    body += element(0x7FE0, 0x10, b"OB" if bits == 8 else b"OW", picture.tobytes())
    with open("picture.dcm", "wb") as file:
        file.write(bytes(128) + b"DICM" + element(2, 0, b"UL", struct.pack("<I", len(meta))) + meta + body)
    return iio.imread("picture.dcm")


bytes_written = np.array([[0, 127, 128], [200, 254, 255]], np.uint8)
counts_written = np.array([[0, 32767, 32768], [40000, 65534, 65535]], np.uint16)
right, signed = [], []
for written in (bytes_written, counts_written):
    plain, rescaled = read(written, False), read(written, True)
    print("imageio", imageio.__version__, "written", written.tolist(), "without slope:", plain.dtype, plain.tolist())
    print("with slope 1 and intercept 0:", rescaled.dtype, rescaled.tolist())
    of_signed = written.view(written.dtype.name.removeprefix("u"))
    right.append(np.array_equal(plain, written) and plain.dtype == written.dtype)
    signed.append(np.array_equal(rescaled, of_signed) and rescaled.dtype == of_signed.dtype)
assert all(right), "without slope: the behaviour has changed"
assert all(signed), "with slope: the behaviour has changed"
PY
