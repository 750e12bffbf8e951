"""Enhanced run-length coding (ERLE) of 24-bit pattern images: encoder and strict decoder.

Here: rows of 24-bit words ↔ the byte stream of DLPU018 section 2.4.3. Not here: the 48-byte image header
(`images`), plain run-length coding (`rle`). Imported by `images` and tests; the wire twin has its own decoder.

Grammar, row by row; n is one byte below 128, else two (low seven bits with the top bit set, then n >> 7)::

    00 00        end of row (optional, we always write it)
    00 01 00     end of image
    00 01 n      copy n pixels from the row above
    00 n px…     n >= 2 literal pixels
    n px         repeat px n times

A pixel is [bits 16-23][bits 8-15][bits 0-7] of its word.
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import U8, U32
from gs2ci_drivers.dlpc900.coding import DecodeFault, check_words, compiled, raise_fault

# Fault codes as plain integers: Numba freezes module constants into the kernel.
_NONE: Final = int(DecodeFault.NONE)
_TRUNCATED: Final = int(DecodeFault.TRUNCATED)
_ROW_OVERRUN: Final = int(DecodeFault.ROW_OVERRUN)
_ROW_UNDERRUN: Final = int(DecodeFault.ROW_UNDERRUN)
_NO_ROW_ABOVE: Final = int(DecodeFault.NO_ROW_ABOVE)
_EMPTY_RUN: Final = int(DecodeFault.EMPTY_RUN)
_EARLY_END: Final = int(DecodeFault.EARLY_END)
_NO_END_MARK: Final = int(DecodeFault.NO_END_MARK)
_TRAILING_BYTES: Final = int(DecodeFault.TRAILING_BYTES)

# What the two leading bytes of a token may mean.
_END_ROW: Final = 0
_COPY: Final = 1
_LITERAL: Final = 2
_REPEAT: Final = 3

# Inside a literal run a pixel costs 3 bytes, so a run is worth leaving it only if it pays for its own header
# and for the header of the literal run that follows.
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
    check_words(words)
    height, width = words.shape
    # One pixel never costs more than four bytes (a repeat of one); each row ends with two, the image with three.
    stream = np.zeros(4 * height * width + 2 * height + 8, np.uint8)
    size = _encode_rows(np.ascontiguousarray(words), stream)
    return stream[: -(-size // 4) * 4].tobytes()


def decode(stream: bytes, width: int, height: int) -> U32:
    """Decode an ERLE stream strictly, as the controller does.

    Args:
        stream: The bytes behind the image header.
        width: Pixels per row.
        height: Rows.

    Returns:
        Words, [H, W] uint32.

    Raises:
        PatternImageError: A run leaves its row, a copy has no row above, the stream ends early, the end mark is
            missing, or more than three bytes follow it.
    """
    words = np.zeros((height, width), np.uint32)
    fault, at = _decode_rows(np.frombuffer(stream, np.uint8), words)
    if fault != DecodeFault.NONE:
        raise_fault("ERLE", DecodeFault(fault), at)
    return words


@compiled
def _put_count(stream: U8, at: int, count: int) -> int:
    if count < 128:
        stream[at] = count
        return at + 1
    stream[at] = (count & 0x7F) | 0x80
    stream[at + 1] = count >> 7
    return at + 2


@compiled
def _put_pixel(stream: U8, at: int, word: int) -> int:
    stream[at] = (word >> 16) & 0xFF
    stream[at + 1] = (word >> 8) & 0xFF
    stream[at + 2] = word & 0xFF
    return at + 3


@compiled
def _put_literals(stream: U8, at: int, row: U32, start: int, end: int) -> int:
    if end - start == 1:
        # A literal run of one does not exist in the grammar; a repeat of one does.
        at = _put_count(stream, at, 1)
    elif end > start:
        stream[at] = 0
        at = _put_count(stream, at + 1, end - start)
    for x in range(start, end):
        at = _put_pixel(stream, at, row[x])
    return at


@compiled
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


@compiled
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
                at = _put_pixel(stream, at, row[x])
                x += repeat
                pending = x
            else:
                x += 1
        at = _put_literals(stream, at, row, pending, width)
        at += 2  # end of row: the stream is zero already
    stream[at + 1] = 1
    return at + 3


@compiled
def _take_count(stream: U8, at: int) -> tuple[int, int]:
    """Read a count; returns (count, next byte), or a next byte past the end where the stream is cut."""
    if at >= stream.shape[0]:
        return 0, stream.shape[0] + 1
    low = int(stream[at])
    if low < 128:
        return low, at + 1
    if at + 1 >= stream.shape[0]:
        return 0, stream.shape[0] + 1
    return (low & 0x7F) | (int(stream[at + 1]) << 7), at + 2


@compiled
def _take_token(stream: U8, at: int) -> tuple[int, int, int]:
    """Read what a run is and how long; returns (kind, count, next byte). A copy of 0 is the end of the image."""
    if at >= stream.shape[0]:
        return _END_ROW, 0, stream.shape[0] + 1
    if stream[at] != 0:
        count, at = _take_count(stream, at)
        return _REPEAT, count, at
    at += 1
    if at < stream.shape[0] and stream[at] == 0:
        return _END_ROW, 0, at + 1
    if at < stream.shape[0] and stream[at] == 1:
        count, at = _take_count(stream, at + 1)
        return _COPY, count, at
    count, at = _take_count(stream, at)
    return _LITERAL, count, at


@compiled
def _pixel(stream: U8, at: int) -> int:
    return (int(stream[at]) << 16) | (int(stream[at + 1]) << 8) | int(stream[at + 2])


@compiled
def _paint(stream: U8, words: U32, token: tuple[int, int, int], y: int, x: int) -> tuple[int, int]:
    """Write the run that `token` (kind, count, next byte) describes at (y, x); returns (fault, next byte)."""
    kind, count, at = token
    if count == 0:
        return _EMPTY_RUN, at
    if x + count > words.shape[1]:
        return _ROW_OVERRUN, at
    if kind == _COPY:
        if y == 0:
            return _NO_ROW_ABOVE, at
        words[y, x : x + count] = words[y - 1, x : x + count]
        return _NONE, at
    pixels = count if kind == _LITERAL else 1
    if at + 3 * pixels > stream.shape[0]:
        return _TRUNCATED, at
    if kind == _LITERAL:
        for i in range(count):
            words[y, x + i] = _pixel(stream, at + 3 * i)
    else:
        words[y, x : x + count] = _pixel(stream, at)
    return _NONE, at + 3 * pixels


@compiled
def _decode_rows(stream: U8, words: U32) -> tuple[int, int]:
    height, width = words.shape
    x = y = at = 0
    while True:
        start = at
        kind, count, at = _take_token(stream, at)
        if at > stream.shape[0]:
            return _TRUNCATED, start
        if kind == _COPY and count == 0:
            break
        if kind == _END_ROW:
            if x < width:
                return _ROW_UNDERRUN if y < height else _NO_END_MARK, start
            x, y = 0, y + 1
            continue
        if x == width:
            # The end-of-row mark is optional: a full row ends by itself.
            x, y = 0, y + 1
        if y >= height:
            return _NO_END_MARK, start
        fault, at = _paint(stream, words, (kind, count, at), y, x)
        if fault != _NONE:
            return fault, start
        x += count
    if y + (x == width) < height:
        return _EARLY_END, start
    return (_TRAILING_BYTES, at) if stream.shape[0] - at > 3 else (_NONE, at)
