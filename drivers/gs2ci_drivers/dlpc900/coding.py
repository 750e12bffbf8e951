"""What both run-length codings share: input checks, decode faults and the compiling decorator.

Imported by `erle`, `rle` and `images` only.
"""

import enum
from collections.abc import Callable
from typing import Any, NoReturn, TypeVar, cast

import numba
import numpy as np

from gs2ci.core.arrays import U32
from gs2ci.core.errors import DeviceError, InputError

# The widest run that two count bytes can carry: seven bits and eight.
MAX_WIDTH = 0x7FFF

AnyFunction = TypeVar("AnyFunction", bound=Callable[..., Any])


class PatternImageError(DeviceError):
    """An encoded pattern image breaks its grammar, its header, or its announced size (device error 9)."""


@enum.unique
class DecodeFault(enum.IntEnum):
    """Why a stream cannot be decoded; the kernels return it because they cannot raise."""

    NONE = 0
    TRUNCATED = 1
    ROW_OVERRUN = 2
    ROW_UNDERRUN = 3
    NO_ROW_ABOVE = 4
    EMPTY_RUN = 5
    EARLY_END = 6
    NO_END_MARK = 7
    TRAILING_BYTES = 8


_SENTENCES = {
    DecodeFault.TRUNCATED: "the stream ends inside a run or before the end mark",
    DecodeFault.ROW_OVERRUN: "a run leaves its row",
    DecodeFault.ROW_UNDERRUN: "a row ends before its last pixel",
    DecodeFault.NO_ROW_ABOVE: "the first row copies from a row above",
    DecodeFault.EMPTY_RUN: "a run has no pixels",
    DecodeFault.EARLY_END: "the end mark stands before the last row",
    DecodeFault.NO_END_MARK: "pixels follow the last row where the end mark should be",
    DecodeFault.TRAILING_BYTES: "more than three bytes follow the end mark",
}


def compiled(function: AnyFunction) -> AnyFunction:
    """Compile a kernel with Numba; the readable original stays reachable as `.py_func`."""
    return cast(AnyFunction, numba.njit(cache=True)(function))


def check_words(words: U32) -> None:
    """Accept words, [H, W] uint32, that can be coded.

    Raises:
        InputError: None at all, another shape or type, more than 24 bits, or rows too wide.
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


def raise_fault(coding: str, fault: DecodeFault, at: int) -> NoReturn:
    """Name the fault and the byte where it was seen.

    Raises:
        PatternImageError: Always.
    """
    raise PatternImageError(
        f"{coding} stream, byte {at}: {_SENTENCES[fault]}",
        remedy="encode the image again; a stream that was read back is damaged",
    )
