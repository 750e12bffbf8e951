"""Plain run-length coding (RLE) of 24-bit pattern images: encoder and strict decoder.

Here: rows of 24-bit words ↔ the byte stream of DLPU018 section 2.4.3. Not here: the 48-byte image header
(`images`), the enhanced coding (`erle`), which is never longer for masks. Imported by `images` and tests.

Grammar, row by row; every count is one byte::

    00 00        end of row, then zeros up to a multiple of four bytes
    00 01        end of image
    00 c px…     c >= 2 literal pixels
    n px         repeat px n times, n <= 255

A pixel is [bits 16-23][bits 8-15][bits 0-7] of its word.
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import U8, U32
from gs2ci_drivers.dlpc900.coding import DecodeFault, check_words, compiled, raise_fault

_MAX_RUN: Final = 255
_NONE: Final = int(DecodeFault.NONE)
_TRUNCATED: Final = int(DecodeFault.TRUNCATED)
_ROW_OVERRUN: Final = int(DecodeFault.ROW_OVERRUN)
_ROW_UNDERRUN: Final = int(DecodeFault.ROW_UNDERRUN)
_EARLY_END: Final = int(DecodeFault.EARLY_END)
_NO_END_MARK: Final = int(DecodeFault.NO_END_MARK)
_TRAILING_BYTES: Final = int(DecodeFault.TRAILING_BYTES)


def encode(words: U32) -> bytes:
    """Encode 24-bit words as an RLE stream, padded to a multiple of four bytes.

    Args:
        words: One 24-bit word per mirror, [H, W] uint32, bits 24-31 zero.

    Returns:
        The stream without image header.

    Raises:
        InputError: The array is empty, not 2-D, not 24-bit, or wider than 32767.

    DLPU018, section 2.4.3.
    """
    check_words(words)
    height, width = words.shape
    # At most four bytes a pixel, two and three bytes of padding a row, two for the image.
    stream = np.zeros(4 * height * width + 5 * height + 8, np.uint8)
    size = _encode_rows(np.ascontiguousarray(words), stream)
    return stream[: -(-size // 4) * 4].tobytes()


def decode(stream: bytes, width: int, height: int) -> U32:
    """Decode an RLE stream strictly, as the controller does.

    Args:
        stream: The bytes behind the image header.
        width: Pixels per row.
        height: Rows.

    Returns:
        Words, [H, W] uint32.

    Raises:
        PatternImageError: A run leaves its row, the stream ends early, the end mark is missing, or more than three
            bytes follow it.
    """
    words = np.zeros((height, width), np.uint32)
    fault, at = _decode_rows(np.frombuffer(stream, np.uint8), words)
    if fault != DecodeFault.NONE:
        raise_fault("RLE", DecodeFault(fault), at)
    return words


@compiled
def _put_pixel(stream: U8, at: int, word: int) -> int:
    stream[at] = (word >> 16) & 0xFF
    stream[at + 1] = (word >> 8) & 0xFF
    stream[at + 2] = word & 0xFF
    return at + 3


@compiled
def _put_literals(stream: U8, at: int, row: U32, start: int, end: int) -> int:
    while start < end:
        count = min(end - start, _MAX_RUN)
        if count == 1:
            # A literal run of one does not exist in the grammar; a repeat of one does.
            stream[at] = 1
            at += 1
        else:
            stream[at + 1] = count
            at += 2
        for x in range(start, start + count):
            at = _put_pixel(stream, at, row[x])
        start += count
    return at


@compiled
def _encode_rows(words: U32, stream: U8) -> int:
    height, width = words.shape
    at = 0
    for y in range(height):
        row = words[y]
        x = 0
        pending = 0  # where the literal run that is still open began
        while x < width:
            end = x + 1
            while end < width and end - x < _MAX_RUN and row[end] == row[x]:
                end += 1
            # Leaving an open literal run costs a new header later, so two equal pixels do not pay.
            if end - x >= 3 or (end - x == 2 and pending == x):
                at = _put_literals(stream, at, row, pending, x)
                stream[at] = end - x
                at = _put_pixel(stream, at + 1, row[x])
                x = end
                pending = x
            else:
                x += 1
        at = _put_literals(stream, at, row, pending, width)
        at = (at + 2 + 3) // 4 * 4
    stream[at + 1] = 1
    return at + 2


@compiled
def _paint(stream: U8, words: U32, at: int, y: int, x: int) -> tuple[int, int, int]:
    """Write the run that starts at byte `at`; returns (fault, next byte, pixels written)."""
    literal = stream[at] == 0
    if literal:
        at += 1
    count = int(stream[at])
    at += 1
    pixels = count if literal else 1
    if x + count > words.shape[1]:
        return _ROW_OVERRUN, at, 0
    if at + 3 * pixels > stream.shape[0]:
        return _TRUNCATED, at, 0
    for i in range(count):
        pixel = at + 3 * i if literal else at
        words[y, x + i] = (int(stream[pixel]) << 16) | (int(stream[pixel + 1]) << 8) | int(stream[pixel + 2])
    return _NONE, at + 3 * pixels, count


@compiled
def _decode_rows(stream: U8, words: U32) -> tuple[int, int]:
    height, width = words.shape
    x = y = at = 0
    while True:
        if at + 2 > stream.shape[0]:
            return _TRUNCATED, at
        if stream[at] == 0 and stream[at + 1] == 1:
            break
        if stream[at] == 0 and stream[at + 1] == 0:
            if x < width:
                return _ROW_UNDERRUN if y < height else _NO_END_MARK, at
            x, y = 0, y + 1
            at = (at + 2 + 3) // 4 * 4
            continue
        if y >= height:
            return _NO_END_MARK, at
        fault, next_at, count = _paint(stream, words, at, y, x)
        if fault != _NONE:
            return fault, at
        x, at = x + count, next_at
    if y < height:
        return _EARLY_END, at
    at += 2
    return (_TRAILING_BYTES, at) if stream.shape[0] - at > 3 else (_NONE, at)
