"""Masks that are believed softer than they were, made sharp again.

A calibration that blurred, or a picture of the masks that was resampled, leaves soft masks: B = R(M) with a known R (a
placement, a blur). Transmissions lie in [0, 1], and for masks of open and closed elements that alone tells most of what R
lost. Here: the inverse by regularised filtering, and by projected steps where places are not on the grid. Not here:
whether it is taken (`admission`).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.reconstruct.measurement.registration.misfit import Misfit, gaussian
from gs2ci.reconstruct.measurement.registration.placement import Placement

# How far frequencies may be raised: masks from a drawing bear more than masks from a noisy calibration.
SHARPENINGS: Final = (1e5, 1e3, 30.0, 5.0)
_STEPS: Final = 40


def unresampled(masks: F64, misfit: Misfit) -> F64:
    """Find transmissions, [N, H, W], in [0, 1] that, moved back and blurred, are the believed masks.

    Args:
        masks: As they are believed: sharp ones lay elsewhere, and were interpolated.
        misfit: Where the sharp ones lie, against the believed; a negative blur tells how soft those are besides.
    """
    back = misfit.placement.inverse
    fraction = np.abs(misfit.placement.shift_px - np.rint(misfit.placement.shift_px))
    # Interpolation at a fraction f of a pixel blurs by f (1 − f), once in the believed masks and once in moving them.
    soft_px2 = max(0.0, -misfit.blur_px2 - 2 * float(np.mean(fraction * (1 - fraction))))
    if soft_px2 < _LEAST_BLUR_PX2:
        soft_px2 = 0.0
    found = np.clip(misfit.of_masks(masks), 0, 1)
    ahead, momentum = found, 1.0
    for _ in range(_STEPS):
        left = masks - gaussian(back.sample(ahead), soft_px2)
        moved = np.clip(ahead + gaussian(misfit.placement.sample(left), soft_px2), 0, 1)
        following = (1 + np.sqrt(1 + 4 * momentum**2)) / 2
        ahead = moved + (momentum - 1) / following * (moved - found)
        found, momentum = moved, following
    return found


_LEAST_BLUR_PX2: Final = 0.05


def candidates(masks: F64, misfit: Misfit) -> list[F64]:
    """Return the ways to sharpen believed masks, [N, H, W] each, that are worth a look; none where none was asked for."""
    if misfit.blur_px2 >= 0:
        return []
    plain = [misfit.of_masks(masks, most) for most in SHARPENINGS]
    whole = Placement(float(np.rint(misfit.placement.down_px)), float(np.rint(misfit.placement.right_px)))
    if misfit.placement == whole:
        return plain
    return [*plain[2:], unresampled(masks, misfit)]
