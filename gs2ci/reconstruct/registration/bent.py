"""Whether readings bend against the open masks, so that no error of the masks explains them.

A leak, a black level, blur and displacement turn the line of readings over open masks; a display's gamma, division by
the masks' sum or a sum that overflowed bend it. What bends is not estimated as a leak, whatever fits best.
"""

from typing import Final

import numpy as np

from gs2ci.core.linearity import Growth, growth
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import white_reading
from gs2ci.reconstruct.registration.parameters import SIGNIFICANT

# Right masks with every error that registration knows bend by less (`python -m tests.benchmarks registration imports`).
_BENT: Final = 0.1
_STEEP: Final = 0.9


def bent_growth(shot: Shot) -> Growth | None:
    """Return how the readings of a shot grow with its open masks if they bend; None if not, or if it cannot be told."""
    readings = shot.measurement[:, :, shot.measurement.shape[2] // 2].astype(np.float64)
    clip = np.inf
    if shot.saturated is not None and shot.saturated.any():
        clip = float(readings[shot.saturated].min())
    found = growth(readings, white_reading(shot), clip=clip, is_mosaic=shot.cfa is not None)
    if found is None or found.is_biased or found.slope > _STEEP:
        return None
    return found if found.curvature < -_BENT - SIGNIFICANT * found.curvature_error else None
