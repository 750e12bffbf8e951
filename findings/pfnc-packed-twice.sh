#!/usr/bin/env bash
# A good guess: the package pfnc knows pixel formats by GenICam's naming convention, so that it tells Mono12Packed, GigE Vision's two pixels in three bytes
# with their low bits side by side, from Mono12p, one bit after the other, and says how large a buffer is. Found: "Packed" is read as
# "p": the two are equal, and each is called Mono12p. Of formats that share colours between neighbours it says three bytes a pixel, where
# their names' numbers in the convention say 16 bits (YUV422_8, BiColorRGBG8) and 12 (YCbCr411_8), and refuses buffers of the right size.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check pfnc==0.1.1 numpy==2.4.6
v/bin/python - <<'PY'
from importlib.metadata import version

from dataspree.pfnc import PixelFormat

print("pfnc", version("pfnc"))
for packed, plain in (("Mono12Packed", "Mono12p"), ("Mono10Packed", "Mono10p"), ("BayerRG12Packed", "BayerRG12p")):
    one, other = PixelFormat.from_name(packed), PixelFormat.from_name(plain)
    print(packed, "is", one.designation(), "equal to", plain, one == other)
    assert one == other and one.designation() == plain, "packed formats: the behaviour has changed"

# Bits a pixel are bits 16 to 23 of a format's number in the convention.
numbers = {"Mono8": 0x01080001, "RGB8": 0x02180014, "YUV422_8": 0x02100032, "BiColorRGBG8": 0x021000A6, "YCbCr411_8": 0x020C005A}
said = {}
for name, number in numbers.items():
    pixel_format, right = PixelFormat.from_name(name), 8 * 4 * (number >> 16 & 255) // 8
    try:
        shape = pixel_format.decode(bytes(right), width=8, height=4).shape
    except ValueError as error:
        shape = str(error)
    said[name] = right, pixel_format.get_buffer_size(8, 4), shape
    print(f"8 x 4 pixels of {name}: {said[name][0]} bytes, pfnc says {said[name][1]}, and of a buffer of the right size", shape)
assert said["Mono8"] == (32, 32, (4, 8)) and said["RGB8"] == (96, 96, (4, 8, 3)), "whole pixels: the behaviour has changed"
for name, right in (("YUV422_8", 64), ("BiColorRGBG8", 64), ("YCbCr411_8", 48)):
    assert said[name][:2] == (right, 96) and isinstance(said[name][2], str), "shared colours: the behaviour has changed"
PY
