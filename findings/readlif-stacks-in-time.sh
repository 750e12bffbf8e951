#!/usr/bin/env bash
# A good guess: readlif's as_array() of a Leica file (LIF) with focus planes, times and channels holds all frames, or refuses. Found: it holds the
# planes at the first time and the times of the first plane, of the first channel alone, in one array: of three planes, three
# times and two channels 6 of 18 frames, one of them twice. Unlike numbers of planes and times are a ValueError, and of 12 bits, for which it
# reads one byte of each two, so is every stack. get_frame() gives each frame.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv v; v/bin/pip install --quiet --disable-pip-version-check --no-deps readlif==0.6.6 pillow==13.0.0 numpy==2.4.6
v/bin/python - <<'PY'
import struct
from importlib.metadata import version

import numpy as np
from readlif.reader import LifFile


def block(begin, text, end=b""):
    content = b"\x2a" + begin + struct.pack("<I", len(text)) + text.encode("utf-16-le")
    return struct.pack("<II", 0x70, len(content)) + content + end


def image(stack, bits):
    """Write a stack of times, planes, channels, rows and columns, and open its image."""
    steps = stack.strides
    channels = "".join(f'<ChannelDescription Resolution="{bits}" BytesInc="{c * steps[2]}"/>' for c in range(stack.shape[2]))
    sizes = {1: (stack.shape[4], steps[4]), 2: (stack.shape[3], steps[3]), 3: (stack.shape[1], steps[1]), 4: (stack.shape[0], steps[0])}
    dimensions = "".join(
        f'<DimensionDescription DimID="{number}" NumberOfElements="{count}" Length="{count - 1}" BytesInc="{step}"/>'
        for number, (count, step) in sizes.items()
    )
    about = (
        '<LMSDataContainerHeader Version="2"><Element Name="run.lif"><Data/><Memory Size="0" MemoryBlockID="MemBlock_0"/><Children>'
        f'<Element Name="Series"><Data><Image><ImageDescription><Channels>{channels}</Channels><Dimensions>{dimensions}</Dimensions>'
        f'</ImageDescription></Image></Data><Memory Size="{stack.nbytes}" MemoryBlockID="MemBlock_1"/></Element></Children>'
        "</Element></LMSDataContainerHeader>"
    )
    with open("run.lif", "wb") as file:
        file.write(block(b"", about) + block(struct.pack("<Q", stack.nbytes) + b"\x2a", "MemBlock_1", stack.tobytes()))
    return LifFile("run.lif").get_image(0)


def refused(stack, bits):
    try:
        return image(stack, bits).as_array().shape
    except ValueError as error:
        return str(error)


numbers = 100 * np.arange(3)[:, None, None] + 10 * np.arange(3)[:, None] + np.arange(2)
stack = np.broadcast_to(numbers[..., None, None], (3, 3, 2, 4, 5)).astype(np.uint8)
opened = image(stack, 8)
single = [[[np.array(opened.get_frame(z=z, t=t, c=c))[0, 0] for c in range(2)] for z in range(3)] for t in range(3)]
whole = opened.as_array()
uneven, twelve = refused(stack[:, :2].copy(), 8), refused(stack.astype(np.uint16), 12)
print("readlif", version("readlif"), "as_array:", whole.shape, whole[..., 0, 0].tolist(), "of", numbers.tolist())
print("two planes at three times:", uneven, "12 bits:", twelve)
assert np.array_equal(single, numbers), "single frames: the behaviour has changed"
assert whole.shape == (2, 3, 4, 5) and whole[..., 0, 0].tolist() == [[0, 10, 20], [0, 100, 200]], "stacks: the behaviour has changed"
assert "inhomogeneous" in str(uneven) and twelve == "not enough image data", "errors: the behaviour has changed"
PY
