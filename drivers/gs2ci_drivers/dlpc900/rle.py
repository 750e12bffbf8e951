"""Plain run-length coding (RLE) of 24-bit pattern images: the encoder.

Here: rows of 24-bit words → the byte stream of DLPU018 section 2.4.3. Not here: the 48-byte image header
(`images`), the enhanced coding (`erle`), which is never longer for masks.

Grammar, row by row; every count is one byte::

    00 00        end of row, then zeros up to a multiple of four bytes
    00 01        end of image
    00 c px…     c >= 2 literal pixels
    n px         repeat px n times, n <= 255

A pixel is [bits 16-23][bits 8-15][bits 0-7] of its word.
"""

from typing import Final

from gs2ci.core.arrays import U8, U32
from gs2ci.core.kernels import helper, kernel, u8_1, u32_2
from gs2ci_drivers.dlpc900.coding import encoded, put_pixel

_MAX_RUN: Final = 255


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
    # Two and three bytes of padding a row, two for the image.
    return encoded(words, 5, _encode_rows)


@helper()
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
            at = put_pixel(stream, at, row[x])
        start += count
    return at


@kernel(u32_2, u8_1)
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
            # Leaving an open literal run needs a new header later, so it does not pay for two equal pixels.
            if end - x >= 3 or (end - x == 2 and pending == x):
                at = _put_literals(stream, at, row, pending, x)
                stream[at] = end - x
                at = put_pixel(stream, at + 1, row[x])
                x = end
                pending = x
            else:
                x += 1
        at = _put_literals(stream, at, row, pending, width)
        at = (at + 2 + 3) // 4 * 4
    stream[at + 1] = 1
    return at + 2
