"""Limits of the scales of pictures: the white of a measurement, depths, errors.

Not here: how they are coloured (`pages/pictures.py`).
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

# The brightest samples are clipped, so that all others keep their contrast.
_BRIGHT_PERCENTILE: Final = 99.5
# A measurement that is black everywhere is shown black, without a division by zero.
_LEAST_WHITE: Final = 1e-6
# Single pixels of wrong depth must not stretch the scale of all others.
_DEPTH_PERCENTILES: Final = (1, 99)
# A plane that faces the camera has a single depth: its scale is widened to be drawable.
_LEAST_DEPTH_SPREAD: Final = 1e-3
_PLANE_LIMITS: Final = (0.9, 1.1)
# Without this lower limit an almost perfect result would look as bad as any other.
_LEAST_ERROR_CEILING: Final = 0.02


def white_level(measurement: NDArray[Any]) -> float:
    """Return the reading of a measurement, [H, W, C], that is shown as white, in its unit."""
    return max(float(np.percentile(measurement, _BRIGHT_PERCENTILE)), _LEAST_WHITE)


def inverse_depth_limits(inverse: NDArray[Any]) -> tuple[float, float]:
    """Return the limits of a scale of inverse depths, [K] > 0.

    Images determine inverse depth with uniform accuracy, because parallax is proportional to it.
    """
    low, high = (float(value) for value in np.percentile(inverse, _DEPTH_PERCENTILES))
    if high - low < _LEAST_DEPTH_SPREAD * high:
        return _PLANE_LIMITS[0] * low, _PLANE_LIMITS[1] * high
    return low, high


def error_ceiling(errors: NDArray[Any]) -> float:
    """Return the upper limit of a scale of errors, of any shape, that begins at zero."""
    return max(float(np.percentile(errors, _BRIGHT_PERCENTILE)), _LEAST_ERROR_CEILING)
