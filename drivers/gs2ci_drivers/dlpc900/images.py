"""Masks to DLPC900 pattern images: bit-planes, the 48-byte header, coding, halves for two controllers. Pure.

Here: [N, H, W] grey levels → 24-bit words → one block of bytes per image. Not here: the coding itself (`erle`),
sending (`driver`). Imported by the driver, `gs2ci.rig` and tests.
"""

import struct
from typing import Final

import numpy as np

from gs2ci.core.arrays import U8, U32
from gs2ci.core.errors import InputError
from gs2ci_drivers.dlpc900 import erle

BITS_PER_WORD: Final = 24
_SIGNATURE: Final = b"Spld"
_LAYOUT: Final = struct.Struct("<4sHHI8sIBBB21s")
_ERLE: Final = 2
_BYTE_ORDER: Final = 1


def encode_block(words: U32, pixel_format: int = 1) -> bytes:
    """Encode one image, with its header of 48 bytes (DLPU018, section 2.4.2).

    Args:
        words: [H, W] uint32, 24-bit words; with two controllers, half the mirrors of a row each.
        pixel_format: Byte 24 of the header: 1 in TI's code, 0 in its guide; users report that both are accepted.
    """
    stream = erle.encode(words)
    height, width = words.shape
    background = 0
    layout = (_SIGNATURE, width, height, len(stream), b"\xff" * 8, background, pixel_format, _ERLE, _BYTE_ORDER, b"")
    return _LAYOUT.pack(*layout) + stream


def pack_planes(levels: U8, depth_bits: int = 1) -> list[U32]:
    """Pack masks into as few 24-bit images as possible; mask i sits `place_of(i, depth_bits)`.

    Args:
        levels: [N, H, W] uint8, each below 2**depth_bits.
        depth_bits: 1 to 8.

    Returns:
        Images, each [H, W] uint32.

    Raises:
        InputError: The depth is not 1 to 8, a level exceeds it, or there is no mask.
    """
    if not 1 <= depth_bits <= 8 or levels.ndim != 3 or not levels.size or levels.dtype != np.uint8:
        raise InputError(
            f"masks of shape {levels.shape}, type {levels.dtype} at {depth_bits} bits",
            allowed="[N, H, W] uint8, at least one, 1 to 8 bits",
        )
    if int(levels.max()) >> depth_bits:
        raise InputError(f"mask level {int(levels.max())}", allowed=f"0 to {(1 << depth_bits) - 1}")
    per_image = BITS_PER_WORD // depth_bits
    images = []
    for first in range(0, len(levels), per_image):
        words = np.zeros(levels.shape[1:], np.uint32)
        for slot, mask in enumerate(levels[first : first + per_image]):
            words |= np.left_shift(mask, np.uint32(slot * depth_bits), dtype=np.uint32)
        images.append(words)
    return images


def place_of(mask_index: int, depth_bits: int = 1) -> tuple[int, int]:
    """Return (image index, lowest bit) of a mask packed by `pack_planes`."""
    image, slot = divmod(mask_index, BITS_PER_WORD // depth_bits)
    return image, slot * depth_bits


def split_halves(words: U32) -> tuple[U32, U32]:
    """Split an image, [H, W], between primary (left) and secondary (right) controller, [H, W / 2] each."""
    half = words.shape[1] // 2
    return words[:, :half], words[:, half:]
