"""The reading of an uploaded pattern image by the DLPC900's firmware: a header, then ERLE, strictly.

Here: bytes → 24-bit words, or an error with its reason. Not here: its two other codings, loading,
memory, display (`dlpc900`). It shares no code with the driver's encoder, so that it detects errors there.
"""

import numpy as np

from gs2ci.core.arrays import U8, U32
from gs2ci.core.kernels import helper, i64, kernel, u8_1, u32_1

HEADER_BYTES = 48
_MAX_SLACK_BYTES = 3


class BadImageError(Exception):
    """The firmware cannot read an image; it will report error 9."""


def read_image(block: bytes, width: int, height: int) -> U32:
    """Read an image block as the controller does.

    Args:
        block: Header and coded pixels.
        width: Columns that this controller drives.
        height: Rows.

    Returns:
        One 24-bit word per mirror, [H, W] uint32.

    Raises:
        BadImageError: Header or stream are invalid.
    """
    header = block[:HEADER_BYTES]
    if len(header) < HEADER_BYTES or header[0:4] != b"\x53\x70\x6c\x64":
        raise BadImageError("no image signature")
    if (header[4] | header[5] << 8, header[6] | header[7] << 8) != (width, height):
        raise BadImageError("the image does not have the size of the mirrors")
    if header[26] != 1 or header[25] != 2 or header[24] > 1:
        raise BadImageError("unknown byte order, compression or pixel format")
    size = int.from_bytes(header[8:12], "little")
    coded = np.frombuffer(bytearray(block), np.uint8, offset=HEADER_BYTES)
    if not size <= coded.size <= size + _MAX_SLACK_BYTES:
        raise BadImageError("the header's size is not the size sent")
    words = np.zeros(height * width, np.uint32)
    end = _read_erle(coded[:size], width, words)
    if end < 0:
        raise BadImageError("the coded pixels break their grammar")
    if size - end > _MAX_SLACK_BYTES:
        raise BadImageError("bytes follow the end of the image")
    return words.reshape(height, width)


_REPEAT, _LITERAL, _COPY, _ROW_END, _CUT = 0, 1, 2, 3, 4


@helper()
def _erle_head(coded: U8, i: int) -> tuple[int, int, int]:
    """Read the head of a run; return its kind, its number of pixels and the index of the byte after the head."""
    size = coded.size
    kind = _REPEAT
    if coded[i] == 0:
        i += 1
        if i < size and coded[i] == 0:
            return _ROW_END, 0, i + 1
        kind = _LITERAL
        if i < size and coded[i] == 1:
            kind = _COPY
            i += 1
    if i >= size:
        return _CUT, 0, i
    low = int(coded[i])
    if low < 0x80:
        return kind, low, i + 1
    if i + 1 >= size:
        return _CUT, 0, i
    return kind, low - 0x80 + int(coded[i + 1]) * 128, i + 2


@helper()
def _fill(coded: U8, i: int, words: U32, cursor: int, count: int, step: int) -> None:
    """Write `count` pixels from byte `i` on, `step` bytes apart (0 repeats one pixel)."""
    for k in range(count):
        at = i + k * step
        words[cursor + k] = int(coded[at]) * 65536 + int(coded[at + 1]) * 256 + int(coded[at + 2])


@kernel(u8_1, i64, u32_1)
def _read_erle(coded: U8, width: int, words: U32) -> int:
    """Fill `words` from a flat cursor; return the byte behind the end mark, or -1."""
    total = words.size
    cursor = 0  # next pixel of the whole image
    marked = 0  # cursor at the last end-of-row mark
    i = 0
    while i < coded.size:
        kind, count, i = _erle_head(coded, i)
        if kind == _CUT:
            return -1
        if kind == _ROW_END:
            if cursor == marked or cursor % width != 0:
                return -1
            marked = cursor
            continue
        if kind == _COPY and count == 0:
            return i if cursor == total else -1
        if count == 0 or cursor + count > total or cursor % width + count > width:
            return -1
        if kind == _COPY:
            if cursor < width:
                return -1
            for k in range(cursor, cursor + count):
                words[k] = words[k - width]
        else:
            stored = count if kind == _LITERAL else 1
            if i + 3 * stored > coded.size:
                return -1
            _fill(coded, i, words, cursor, count, 3 if kind == _LITERAL else 0)
            i += 3 * stored
        cursor += count
    return -1
