"""What both run-length codings share: input checks, pixels, and how a stream is made.

Not here: the grammars (`erle`, `rle`), the header (`images`). Only the controller reads a stream; its twin has a reader
of its own (`gs2ci_sims.wires.dlpc900_images`).
"""

from collections.abc import Callable

import numpy as np

from gs2ci.core.arrays import U8, U32
from gs2ci.core.errors import InputError
from gs2ci.core.kernels import helper

# The widest run that two count bytes can carry: seven bits and eight.
MAX_WIDTH = 0x7FFF


def encoded(words: U32, most_bytes_per_row: int, encode_rows: Callable[[U32, U8], int]) -> bytes:
    """Encode an image, padded to a multiple of four bytes.

    Args:
        words: One 24-bit word per mirror, [H, W] uint32, bits 24-31 zero.
        most_bytes_per_row: Most bytes that a row takes beside its pixels; one pixel never takes more than four bytes.
        encode_rows: Writes the stream into a buffer of zeros and returns its length.

    Raises:
        InputError: The array is empty, not 2-D, not 24-bit, or wider than 32767.
    """
    check_words(words)
    height, width = words.shape
    stream = np.zeros(4 * height * width + most_bytes_per_row * height + 8, np.uint8)
    size = encode_rows(np.ascontiguousarray(words), stream)
    return stream[: -(-size // 4) * 4].tobytes()


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


@helper()
def put_pixel(stream: U8, at: int, word: int) -> int:
    """Write a pixel, [bits 16-23][bits 8-15][bits 0-7] of its word; return the next byte."""
    stream[at] = (word >> 16) & 0xFF
    stream[at + 1] = (word >> 8) & 0xFF
    stream[at + 2] = word & 0xFF
    return at + 3
