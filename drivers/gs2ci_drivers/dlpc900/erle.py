"""Enhanced run-length coding (ERLE) of 24-bit pattern images: the encoder.

Here: rows of 24-bit words → the byte stream of DLPU018 section 2.4.3. Not here: the 48-byte image header
(`images`), plain run-length coding (`rle`), reading a stream, which only the controller and its twin do.

Grammar, row by row; n is one byte below 128, else two (low seven bits with the top bit set, then n >> 7)::

    00 00        end of row (optional, we always write it)
    00 01 00     end of image
    00 01 n      copy n pixels from the row above
    00 n px…     n >= 2 literal pixels
    n px         repeat px n times

A pixel is [bits 16-23][bits 8-15][bits 0-7] of its word.
"""

from typing import Final

from gs2ci.core.arrays import U8, U32
from gs2ci.core.kernels import helper, kernel, u8_1, u32_2
from gs2ci_drivers.dlpc900.coding import encoded, put_pixel

# Inside a literal run a pixel takes 3 bytes. Leaving it for a run is worthwhile only if that saves more than the run's
# header and the header of the literal run that follows.
_COPY_BREAKS_LITERAL: Final = 2
_REPEAT_BREAKS_LITERAL: Final = 3


def encode(words: U32) -> bytes:
    """Encode 24-bit words as an ERLE stream, padded to a multiple of four bytes.

    Args:
        words: One 24-bit word per mirror, [H, W] uint32, bits 24-31 zero.

    Returns:
        The stream without image header. Greedy: within a few bytes per row of the shortest for masks.

    Raises:
        InputError: The array is empty, not 2-D, not 24-bit, or wider than 32767.

    DLPU018, section 2.4.3.
    """
    # Each row ends with two bytes, the image with three.
    return encoded(words, 2, _encode_rows)


@helper()
def _put_count(stream: U8, at: int, count: int) -> int:
    if count < 128:
        stream[at] = count
        return at + 1
    stream[at] = (count & 0x7F) | 0x80
    stream[at + 1] = count >> 7
    return at + 2


@helper()
def _put_literals(stream: U8, at: int, row: U32, start: int, end: int) -> int:
    if end - start == 1:
        # A literal run of one does not exist in the grammar; a repeat of one does.
        at = _put_count(stream, at, 1)
    elif end > start:
        stream[at] = 0
        at = _put_count(stream, at + 1, end - start)
    for x in range(start, end):
        at = put_pixel(stream, at, row[x])
    return at


@helper()
def _run_lengths(row: U32, above: U32, x: int, has_above: bool) -> tuple[int, int]:
    width = row.shape[0]
    end = x + 1
    while end < width and row[end] == row[x]:
        end += 1
    repeat = end - x
    end = x
    if has_above:
        while end < width and row[end] == above[end]:
            end += 1
    return repeat, end - x


@kernel(u32_2, u8_1)
def _encode_rows(words: U32, stream: U8) -> int:
    height, width = words.shape
    at = 0
    for y in range(height):
        row = words[y]
        above = words[max(y - 1, 0)]
        x = 0
        pending = 0  # where the literal run that is still open began
        while x < width:
            repeat, copy = _run_lengths(row, above, x, y > 0)
            if copy >= _COPY_BREAKS_LITERAL and copy >= repeat:
                at = _put_literals(stream, at, row, pending, x)
                stream[at] = 0
                stream[at + 1] = 1
                at = _put_count(stream, at + 2, copy)
                x += copy
                pending = x
            elif repeat >= _REPEAT_BREAKS_LITERAL or (repeat == 2 and pending == x):
                at = _put_literals(stream, at, row, pending, x)
                at = _put_count(stream, at, repeat)
                at = put_pixel(stream, at, row[x])
                x += repeat
                pending = x
            else:
                x += 1
        at = _put_literals(stream, at, row, pending, width)
        at += 2  # end of row: the stream is zero already
    stream[at + 1] = 1
    return at + 3
