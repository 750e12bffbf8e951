"""Light: the unit of a measurement, masks stated dimmer than they are, and clipping that is not marked.

Readings determine only the product of scene, masks and unit. The unit follows from convention: scenes are exposed to
fill a fair part of the scale, and a fully open element transmits all light. So a unit is doubted only if most of the
picture would be brighter than white, or none of it as bright as a fiftieth.

Here: those three. Not here: black level and leak, which readings do determine (`fine`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import DARK, white_reading

# Lamps and glints are less than a quarter of a picture: the unit is doubted if more is brighter than white.
_MOSTLY: Final = 0.75
_BRIGHT: Final = 0.999
# The brightest part of a well-exposed scene lies in this range of the scale.
_EXPOSED: Final = (0.25, 1.1)
_TAKEN_FOR: Final = 0.9
_COUNTS: Final = (255.0, 1023.0, 4095.0, 16383.0, 65535.0)
_POWERS: Final = tuple(10.0**k for k in range(-12, 13) if k)

# An element that passes this share of what the most open one does is fully open, too; so is one that passes as much.
_OPEN_FULLY: Final = 0.97
_OPEN_SHARE: Final = 0.5

_LEAST_CLIPPED: Final = 1e-3
_FEWEST_CLIPPED: Final = 16
_PILE: Final = 3.0


@dataclass(frozen=True)
class Unit:
    """The factor by which readings are too large, and the reason."""

    factor: float
    reason: str


def find_unit(level: F64, counts: Bool, integers: bool, *, stated: bool = False) -> Unit | None:
    """Find the unit of a measurement whose scene would be mostly brighter than white, or nowhere as bright as 0.02.

    Args:
        level: The scene's local level under the stated unit, [K].
        counts: Which of them are known, [K].
        integers: Whether the readings are whole numbers, as a camera's counts are.
        stated: Whether somebody who knows has stated the unit: then a dark scene is dark.

    Returns:
        The divisor of the readings; None if the unit is plausible, or the scene is black.
    """
    known = level[counts]
    if known.size == 0:
        return None
    bright, mostly = float(np.quantile(known, _BRIGHT)), float(np.quantile(known, _MOSTLY))
    if bright <= 0 or (mostly <= _EXPOSED[1] and (stated or bright >= DARK)):
        return None
    for usual, name in ((_COUNTS, "camera counts"), (_POWERS, "a power of ten")):
        if usual is _COUNTS and not integers:
            continue
        fitting = [factor for factor in usual if _EXPOSED[0] <= bright / factor <= _EXPOSED[1]]
        if fitting:
            factor = min(fitting, key=lambda one: abs(np.log(bright / one / _TAKEN_FOR)))
            return Unit(factor, name)
    return Unit(bright / _TAKEN_FOR, f"its brightest thousandth taken for {_TAKEN_FOR:g} of white")


def open_level(masks: F32) -> float:
    """Return the transmission of a fully open element in the stated masks, [N, H, W]; 1 unless it is clearly smaller.

    It is if most open elements transmit the same share below 1; elements softened by blur do not.
    """
    top = float(masks.max())
    if top <= 0 or top >= _OPEN_FULLY:
        return 1.0
    opened = masks > 0.5 * top
    near = float(np.mean(masks[opened] >= _OPEN_FULLY * top))
    return top if near >= _OPEN_SHARE else 1.0


def untold_clipping(shot: Shot) -> Bool | None:
    """Find the pixels, [H, W], that read the highest value, if so many do that they must be clipped; otherwise None.

    Towards the top of a scene's range, readings become rare. If a share of the pixels read one value at the very top,
    far more than read the values just below, the range of the sensor or file ended there. Pixels with equal light but
    different open masks would not read the same; pixels with the same open masks may.
    """
    if shot.saturated is not None:
        return None
    readings = shot.measurement
    top = float(readings.max())
    low = float(np.quantile(readings, 0.01))
    if top <= 0 or top <= low:
        return None
    width = 1e-6 * (top - low)
    piled = readings >= top - width
    count = int(piled.sum())
    if count < max(_FEWEST_CLIPPED, _LEAST_CLIPPED * readings.size):
        return None
    # The same number of next lower readings: what range of values do they cover?
    rest = np.sort(readings[~piled])[::-1]
    if rest.size == 0:
        return None
    beside = float(np.mean(rest >= top - 0.01 * (top - low))) * readings.size
    if count < _PILE * max(beside, 1.0) and count < 0.1 * readings.size:
        return None
    clipped: Bool = np.any(piled, axis=2)
    white = white_reading(shot)[clipped]
    if float(white.std()) < 1e-3 * float(white.mean()):
        return None
    return clipped
