"""Standard errors of views, pixel by pixel.

How large they are follows from the readings: what the scene's views leave of them, at pixels that the fit saw and at
those held out, per unit of light that errors would send there, N views sharing one reading. Where they are follows from
the residual about each pixel and the spread of several fits, and from what the pixel's own reading says of each view.
Here: that. Not here: the factors (`factors`), depths and poses.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.uncertainty.factors import factors


@dataclass(frozen=True, eq=False)
class ViewsMade:
    """The views of one exposure, before and after they were combined; [N, H, W, C] each.

    Args:
        delivered: As each mask saw them.
        scene: The mean of the fits' views.
        disagreement: How far several fits are from their mean, [N, H, W]; None with one fit.
    """

    delivered: F32
    scene: F32
    disagreement: F32 | None


def errors_of_views(holdout: Holdout, views: ViewsMade, alike: F64, noise: F32) -> F32:
    """Return the standard error of each view's values, [N, H, W], full scale 1.

    Args:
        holdout: The measurement, and its held-out pixels.
        views: The views.
        alike: Correlation of the errors of two views at one pixel, [N, N] (`errors_alike`).
        noise: Power of the readings' noise by what the scene leaves of them, [H, W, C] (`measurement.noise`).
    """
    shot = holdout.shot
    transmissions = shot.transmissions
    reached = np.tensordot(alike.astype(np.float32), transmissions, axes=1)
    light = np.einsum("nhw,nhw->hw", transmissions, reached, dtype=np.float64)
    usable = shot.usable & ~holdout.pixels
    if not usable.any() or light[usable].mean() <= 0:
        return np.full(transmissions.shape, factors.unknown_view, np.float32)
    residual = shot.measurement - holdout.coded(views.scene)
    power = np.mean(residual.astype(np.float64) ** 2, axis=-1)
    level = _level(holdout, views, light, power, noise)
    full = float(transmissions.max()) ** 2
    pattern = _pattern(views, np.where(usable, power, 0.0), np.where(usable, light, 0.0), full)
    # What the pixel's reading takes away along its masks.
    divided = np.maximum(light, factors.least_light * full)
    for shown, there in zip(pattern, reached, strict=True):
        known = np.clip(there**2 / divided, 0, 1)
        shown[:] = np.sqrt(level * shown * (1 - factors.own_reading * known))
    return pattern


def errors_alike(flow_px2: F64) -> F64:
    """Return how much the errors of two views at one pixel are alike, [N, N].

    Args:
        flow_px2: How far the picture moves from one view to the other, squared, [N, N, P] at P places.
    """
    both = (flow_px2 + flow_px2.transpose(1, 0, 2)) / 2
    return np.exp(-both / (2 * factors.alike_px**2)).mean(axis=2)


def _level(holdout: Holdout, views: ViewsMade, light: F64, power: F64, noise: F32) -> float:
    """Return the mean power of the views' errors."""
    usable = holdout.shot.usable & ~holdout.pixels
    per_light = float(light[usable].mean())
    seen = float(power[usable].mean()) / per_light
    unseen = factors.unseen * seen
    if holdout.pixels.any() and (there := float(light[holdout.pixels].mean())) > 0:
        unseen = float(holdout.squared_residuals(views.scene).mean()) / there
    if seen <= 0:
        return 0.0
    share = float(noise[usable].mean(dtype=np.float64)) / per_light / seen
    rest = 1 - min(1.0, share) ** factors.noise_order
    return float(factors.level * np.sqrt(seen * unseen) * max(rest, factors.least_of_level))


def _pattern(views: ViewsMade, power: F64, light: F64, full: float) -> F32:
    """Return where errors are, as shares of their mean power, [N, H, W]; `power` and `light` are 0 at unused pixels."""
    near, lit = (gaussian_filter(one, factors.neighbourhood_px, mode="nearest") for one in (power, light))
    about = np.tile(_shares(near / np.maximum(lit, factors.least_light * full)), (len(views.delivered), 1, 1))
    if views.disagreement is None:
        return about
    return about + np.float32(factors.pattern_of_fits) * (_shares(views.disagreement**2) - about)


def _shares(power: F64 | F32) -> F32:
    """Return power as shares of its mean; 1 where there is none anywhere."""
    mean = power.mean(dtype=np.float64)
    return (power / mean if mean > 0 else np.ones_like(power)).astype(np.float32)
