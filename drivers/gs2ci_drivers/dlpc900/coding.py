"""What both run-length codings share: input checks, pixels, and where words repeat.

Not here: the grammars (`erle`, `rle`), the header (`images`). Only the controller reads a stream; its twin has a reader
of its own (`gs2ci_sims.wires.dlpc900_images`).
"""

import numpy as np

from gs2ci.core.arrays import I64, U32, Bool
from gs2ci.core.errors import InputError

# The widest run that two count bytes can carry: seven bits and eight.
MAX_WIDTH = 0x7FFF


def padded(stream: bytes) -> bytes:
    """Pad a stream with zeros to a multiple of four bytes."""
    return stream + bytes(-len(stream) % 4)


def pixel_bytes(words: U32) -> list[bytes]:
    """Return the pixels of each row, [bits 16-23][bits 8-15][bits 0-7] of each word."""
    low_first = np.ascontiguousarray(words, "<u4").view(np.uint8).reshape(*words.shape, 4)
    return [row.tobytes() for row in low_first[..., 2::-1]]


def repeats(words: U32) -> I64:
    """Return for each word how often it stands there in a row, itself included, [H, W]."""
    same = np.zeros(words.shape, bool)
    same[:, :-1] = words[:, 1:] == words[:, :-1]
    return run_lengths(same) + 1


def run_lengths(true: Bool) -> I64:
    """Return for each place, [H, W], how many are true in a row from it on."""
    columns = np.arange(true.shape[1])
    next_false = np.minimum.accumulate(np.where(true, true.shape[1], columns)[:, ::-1], axis=1)[:, ::-1]
    return next_false - columns


def check_words(words: U32) -> None:
    """Check that words, [H, W] uint32, can be coded.

    Raises:
        InputError: The array is empty, has another shape or type, more than 24 bits, or rows too wide.
    """
    if words.ndim != 2 or words.size == 0 or words.dtype != np.uint32 or words.shape[1] > MAX_WIDTH:
        raise InputError(
            f"a pattern image of shape {words.shape} and type {words.dtype} cannot be coded",
            allowed=f"[H, W] uint32 with 1 to {MAX_WIDTH} columns",
        )
    if int(words.max()) >> 24:
        raise InputError(
            f"a pattern image holds the word {int(words.max()):#x}",
            allowed="24 bit-planes: words up to 0xffffff",
        )
