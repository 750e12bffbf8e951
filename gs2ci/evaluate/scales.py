"""Where the scales of pictures begin and end: the white of a measurement, depths, errors.

Not here: how they are coloured (`panels.py`, `pages/pictures.py`).
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

# The brightest samples may lose their contrast, so that all others keep theirs.
_BRIGHT_PERCENTILE: Final = 99.5
# A measurement that is black throughout is shown black, and not divided by its zero.
_LEAST_WHITE: Final = 1e-6
# Single pixels of wrong depth shall not stretch the scale of all others.
_DEPTH_PERCENTILES: Final = (1, 99)
# A plane that faces the camera has one depth: its scale is widened to show that.
_LEAST_DEPTH_SPREAD: Final = 1e-3
_PLANE_LIMITS: Final = (0.9, 1.1)
# An almost perfect result would otherwise look as bad as any other.
_LEAST_ERROR_CEILING: Final = 0.02


def white_level(measurement: NDArray[Any]) -> float:
    """Choose the reading of a measurement, [H, W, C], that is shown white, in its unit."""
    return max(float(np.percentile(measurement, _BRIGHT_PERCENTILE)), _LEAST_WHITE)


def inverse_depth_limits(inverse: NDArray[Any]) -> tuple[float, float]:
    """Choose where a scale of inverse depths, [K] > 0, begins and ends.

    Inverse depth is what images determine evenly: parallax is proportional to it.
    """
    low, high = (float(value) for value in np.percentile(inverse, _DEPTH_PERCENTILES))
    if high - low < _LEAST_DEPTH_SPREAD * high:
        return _PLANE_LIMITS[0] * low, _PLANE_LIMITS[1] * high
    return low, high


def error_ceiling(errors: NDArray[Any]) -> float:
    """Choose where a scale of errors, of any shape, that begins at zero ends."""
    return max(float(np.percentile(errors, _BRIGHT_PERCENTILE)), _LEAST_ERROR_CEILING)
