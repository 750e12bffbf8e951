"""Slopes of pictures: differences between neighbouring pixels."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64

Numbers = NDArray[Any]


def slopes(values: Numbers) -> tuple[F64, F64]:
    """Return how maps, [..., H, W], change per pixel down and across; 0 along a side of a single pixel."""
    down, across = (
        np.gradient(values, axis=axis) if values.shape[axis] > 1 else np.zeros_like(values) for axis in (-2, -1)
    )
    return down, across
