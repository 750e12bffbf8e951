"""Enhanced run-length coding (ERLE) of 24-bit pattern images: the encoder.

Here: rows of 24-bit words → the byte stream of DLPU018 section 2.4.3. Not here: the 48-byte image header
(`images`), reading a stream, which only the controller and its twin do (`gs2ci_sims.wires.dlpc900_images`).

Grammar, row by row; n is one byte below 128, else two (low seven bits with the top bit set, then n >> 7)::

    00 00        end of row (optional, we always write it)
    00 01 00     end of image
    00 01 n      copy n pixels from the row above
    00 n px…     n >= 2 literal pixels
    n px         repeat px n times

A pixel is [bits 16-23][bits 8-15][bits 0-7] of its word.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from gs2ci.core.arrays import I64, U32, Bool

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

    DLPU018, section 2.4.3.
    """
    copied = np.zeros(words.shape, bool)
    copied[1:] = words[1:] == words[:-1]
    # Most rows of masks repeat the one above, and are one copy of it.
    width = words.shape[1]
    anew = ~copied.all(axis=1) | (width < _COPY_BREAKS_LITERAL)
    above = b"\0\1" + _count(width) + b"\0\0"
    rows = map(_row, _pixel_bytes(words[anew]), _repeats(words[anew]), _run_lengths(copied[anew]))
    return _padded(b"".join(b"".join(next(rows)) if new else above for new in anew) + b"\0\1\0")


def _row(pixels: bytes, repeat: I64, copy: I64) -> Iterator[bytes]:
    """Encode a row: the lengths of runs that begin at each of its words, of equal words and of words as above."""
    copies = (copy >= _COPY_BREAKS_LITERAL) & (copy >= repeat)
    starts = np.flatnonzero(copies | (repeat > 1))
    at = pending = 0  # where the literal run that is still open began
    for start, copying, copied, repeated in zip(
        starts.tolist(), copies[starts].tolist(), copy[starts].tolist(), repeat[starts].tolist(), strict=True
    ):
        if start < at:
            continue
        if copying:
            yield _literals(pixels, pending, start) + b"\0\1" + _count(copied)
            at = pending = start + copied
        elif repeated >= _REPEAT_BREAKS_LITERAL or pending == start:
            yield _literals(pixels, pending, start) + _count(repeated) + pixels[3 * start : 3 * start + 3]
            at = pending = start + repeated
    yield _literals(pixels, pending, len(repeat)) + b"\0\0"


def _count(count: int) -> bytes:
    return bytes((count,) if count < 128 else ((count & 0x7F) | 0x80, count >> 7))


def _literals(pixels: bytes, start: int, end: int) -> bytes:
    if start == end:
        return b""
    # A literal run of one does not exist in the grammar; a repeat of one does.
    header = b"\1" if end - start == 1 else b"\0" + _count(end - start)
    return header + pixels[3 * start : 3 * end]


def _padded(stream: bytes) -> bytes:
    """Pad a stream with zeros to a multiple of four bytes."""
    return stream + bytes(-len(stream) % 4)


def _pixel_bytes(words: U32) -> list[bytes]:
    """Return the pixels of each row, [bits 16-23][bits 8-15][bits 0-7] of each word."""
    low_first = np.ascontiguousarray(words, "<u4").view(np.uint8).reshape(*words.shape, 4)
    return [row.tobytes() for row in low_first[..., 2::-1]]


def _repeats(words: U32) -> I64:
    """Return for each word how often it stands there in a row, itself included, [H, W]."""
    same = np.zeros(words.shape, bool)
    same[:, :-1] = words[:, 1:] == words[:, :-1]
    return _run_lengths(same) + 1


def _run_lengths(true: Bool) -> I64:
    """Return for each place, [H, W], how many are true in a row from it on."""
    columns = np.arange(true.shape[1])
    next_false = np.minimum.accumulate(np.where(true, true.shape[1], columns)[:, ::-1], axis=1)[:, ::-1]
    return next_false - columns
