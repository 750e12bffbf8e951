"""The noise of the readings, estimated from what a scene's views leave of them.

Here: its power in each reading, and on the average. Not here: what follows from it (`decode.pnp`, `fit.combining`).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.reconstruct.measurement.holdout import Holdout

# A fit follows some of the noise at the pixels that it sees, so that the noise there is larger than the residual shows.
_FOLLOWED: Final = 1.1
# The median of the absolute value of a standard normal deviate. The noise is estimated from the median residual, which
# a model that is wrong only in places hardly changes.
MEDIAN_DEVIATE: Final = 0.6745
# Photons make more noise in bright readings, so readings are divided into classes of equal size by their prediction:
# at most so many, and none with fewer readings than this, whose median tells the power to a seventh.
_CLASSES: Final = 16
_LEAST_READINGS: Final = 256


def noise_of_readings(holdout: Holdout, views: F32) -> F32:
    """Return an upper bound on the power of the noise in each reading, from a scene's residual at pixels that it saw.

    What a scene lacks everywhere counts as noise.

    Args:
        holdout: The measurement.
        views: Of a scene, which cannot follow the noise of single pixels, [N, H, W, C].

    Returns:
        In squared units of the measurement, [H, W, C] as the measurement; 0 if there is no usable pixel.
    """
    asked = holdout.shot.usable & ~holdout.pixels
    predicted = holdout.coded(views)
    if not asked.any():
        return np.zeros_like(predicted)
    light = predicted[asked].ravel()
    left = np.abs(holdout.shot.measurement[asked].ravel() - light)
    classes = np.array_split(np.argsort(light, kind="stable"), np.clip(light.size // _LEAST_READINGS, 1, _CLASSES))
    middle = [float(light[one].mean(dtype=np.float64)) for one in classes]
    power = [_FOLLOWED * (float(np.median(left[one])) / MEDIAN_DEVIATE) ** 2 for one in classes]
    return np.interp(predicted, middle, power).astype(np.float32)


def mean_power(noise: F32, holdout: Holdout) -> float:
    """Return the mean power of the noise, [H, W, C], over the usable pixels; 0 if there is none."""
    usable = holdout.shot.usable
    return float(noise[usable].mean(dtype=np.float64)) if usable.any() else 0.0


def followed(holdout: Holdout, views: F32) -> float:
    """Return by what factor the mean power of the noise may exceed the one above, since the views have followed it.

    Where a fit has followed noise, its residual is too small at pixels that it saw, and too large by about the same
    factor at held-out ones, where what it followed is an error: the power is the geometric mean of the two. Detail that
    the views lack counts as noise too. A decode that adds this detail must not weigh so much noise, but weights of
    candidates that repeat noise must.

    Args:
        holdout: The measurement.
        views: Of the scene, [N, H, W, C], from which the noise of the readings was estimated.

    Returns:
        At least 1; 1 if there are no such pixels.
    """
    usable = holdout.shot.usable
    seen, unseen = usable & ~holdout.pixels, usable & holdout.pixels
    if not (seen.any() and unseen.any()):
        return 1.0
    left = np.abs(holdout.shot.measurement - holdout.coded(views))
    at_seen, at_unseen = float(np.median(left[seen])), float(np.median(left[unseen]))
    return max(1.0, at_unseen / at_seen / _FOLLOWED) if at_seen > 0 else 1.0
