"""A sum that vectorises and has the same bits on every processor: the kernels of a fit add up with it.

Not here: what is added.
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.kernels import helper

_LANES: Final = 16


@helper()
def sum_in_lanes(values: F32) -> float:
    """Add up in float64, sixteen sums side by side and then those in order."""
    lanes = np.zeros(_LANES)
    whole = len(values) // _LANES * _LANES
    for x in range(0, whole, _LANES):
        for lane in range(_LANES):
            lanes[lane] += values[x + lane]
    total = 0.0
    for lane in range(_LANES):
        total += lanes[lane]
    for x in range(whole, len(values)):
        total += values[x]
    return total
