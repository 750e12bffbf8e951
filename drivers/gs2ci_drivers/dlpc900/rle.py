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

from collections.abc import Iterator
from typing import Final

import numpy as np

from gs2ci.core.arrays import I64, U32
from gs2ci_drivers.dlpc900.coding import check_words, padded, pixel_bytes, repeats

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
    check_words(words)
    rows = (padded(b"".join(_row(*each))) for each in zip(pixel_bytes(words), repeats(words), strict=True))
    return padded(b"".join(rows) + b"\0\1")


def _row(pixels: bytes, repeat: I64) -> Iterator[bytes]:
    """Encode a row: the lengths of runs of equal words that begin at each of its words."""
    starts = np.flatnonzero(repeat > 1)
    at = pending = 0  # where the literal run that is still open began
    for start, left in zip(starts.tolist(), repeat[starts].tolist(), strict=True):
        run = min(left, _MAX_RUN)
        # Leaving an open literal run needs a new header later, so it does not pay for two equal pixels.
        if start < at or (run == 2 and pending != start):
            continue
        yield _literals(pixels, pending, start) + bytes((run,)) + pixels[3 * start : 3 * start + 3]
        at = pending = start + run
    yield _literals(pixels, pending, len(repeat)) + b"\0\0"


def _literals(pixels: bytes, start: int, end: int) -> bytes:
    pieces = []
    for first in range(start, end, _MAX_RUN):
        count = min(end - first, _MAX_RUN)
        # A literal run of one does not exist in the grammar; a repeat of one does.
        pieces += [b"\1" if count == 1 else bytes((0, count)), pixels[3 * first : 3 * (first + count)]]
    return b"".join(pieces)
