"""Curves along which readings are stored instead of in proportion to light, and how each is undone.

Here: display gammas, the square root by which cameras squeeze 12 bits into 8, division by the masks' sum. Not here:
sums that overflowed (`overflow`), which of them a file shows (`light`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64
from gs2ci.core.foreign.scale import smallest_full_scale

CurveName = Literal["auto", "linear", "srgb", "gamma", "root", "divided", "overflow"]

# Counts that were divided and multiplied again in float32 are whole numbers up to this share of one.
_WHOLE: Final = 0.02


@dataclass(frozen=True)
class Curve:
    """A way in which readings may be stored.

    Args:
        name: What the user calls it.
        words: What a sentence calls it.
        undo: Turns readings under so many open masks, and their full scale, into light.
        is_known: Whether its constants are, so that it can be undone.
    """

    name: CurveName
    words: str
    undo: Callable[[F64, F64, float], F64]
    is_known: bool = True


def light_of_srgb(values: F64) -> F64:
    """Return the light that a display makes of values (at least 0; 1 is white), the inverse of IEC 61966-2-1."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def _from_srgb(readings: F64, _: F64, full: float) -> F64:
    return full * light_of_srgb(np.maximum(readings, 0) / full)


def _power(exponent: float) -> Callable[[F64, F64, float], F64]:
    def undo(readings: F64, _: F64, full: float) -> F64:
        return full * (np.maximum(readings, 0) / full) ** exponent

    return undo


def _exponential(strength: float) -> Callable[[F64, F64, float], F64]:
    def undo(readings: F64, _: F64, full: float) -> F64:
        return full * np.expm1(np.maximum(readings, 0) / full * np.log1p(strength)) / strength

    return undo


def _multiplied(readings: F64, open_masks: F64, _: float) -> F64:
    return readings * open_masks


DIVIDED: Final = Curve("divided", "readings divided by the sum of the masks", _multiplied)
DISPLAY_CURVES: Final = (
    Curve("srgb", "a display's gamma (sRGB)", _from_srgb),
    Curve("gamma", "a display's gamma (2.2)", _power(2.2)),
    Curve("root", "a square root, by which cameras squeeze many bits into few", _power(2.0)),
)
LOGARITHMS: Final = tuple(
    Curve("auto", "a logarithm", _exponential(float(strength)), is_known=False)
    for strength in 10 ** np.arange(0.5, 4.1, 0.5)
)
CURVES: Final = (*DISPLAY_CURVES, DIVIDED)
"""Those that can be undone."""


def full_scale(stored: NDArray[Any]) -> float:
    """Return the reading that stands for 1 in a display's encoding: the type's, or the smallest usual one."""
    high = float(stored.max())
    if stored.dtype == np.uint8:
        return 255.0
    return smallest_full_scale(high) or high


def as_counts(readings: F64) -> F64:
    """Round readings that are whole numbers but for the digits of float32."""
    near = np.rint(readings)
    return near if float(near.max()) > 1 and float(np.abs(readings - near).max()) < _WHOLE else readings
