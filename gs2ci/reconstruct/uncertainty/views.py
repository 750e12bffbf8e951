"""Standard errors of views, pixel by pixel.

How large they are follows from the readings: what the scene's views leave of them, at pixels that the fit saw and at
those held out, per unit of light that errors would send there, N views sharing one reading. Where they are follows from
the residual about each pixel, the detail there, the decode and the spread of several fits, and from what the pixel's
own reading says of each view. Here: that. Not here: the factors (`factors`), depths and poses.
"""

from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import gaussian_filter

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.uncertainty.factors import factors
from gs2ci.reconstruct.uncertainty.slopes import slopes


@dataclass(frozen=True, eq=False)
class ViewsMade:
    """The views of one exposure, before and after they were combined; [N, H, W, C] each.

    Args:
        delivered: As each mask saw them.
        scene: The mean of the fits' views.
        decoded: Without a scene.
        disagreement: How far several fits are from their mean, [N, H, W]; None with one fit.
    """

    delivered: F32
    scene: F32
    decoded: F32
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
    divided = np.maximum(light, factors.little_light * full)
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
    found: F64 = np.exp(-both / (2 * factors.alike_px**2)).mean(axis=2)
    return found


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
    about = _smooth(power, factors.neighbourhood_px) / np.maximum(
        _smooth(light, factors.neighbourhood_px), factors.least_light * full
    )
    down, across = slopes(torch.from_numpy(_smooth(views.delivered.mean(axis=-1), 0.5)))
    apart = np.stack([np.mean((a - b) ** 2, axis=-1) for a, b in zip(views.decoded, views.delivered, strict=True)])
    parts = [
        (factors.pattern_of_residual, np.broadcast_to(about, views.delivered.shape[:3])),
        (factors.pattern_of_detail, _smooth((down**2 + across**2).numpy(), 1.2)),
        (factors.pattern_of_decode, _smooth(apart, 1.0)),
    ]
    if views.disagreement is not None:
        parts.append((factors.pattern_of_fits, views.disagreement**2))
    means = [float(values.mean(dtype=np.float64)) for _, values in parts]
    total = np.zeros(views.delivered.shape[:3], np.float32)
    for (part, values), mean in zip(parts, means, strict=True):
        if mean > 0:
            total += values * np.float32(part / mean)
    mean = float(total.mean(dtype=np.float64))
    return total / np.float32(mean) if mean > 0 else np.ones_like(total)


def _smooth(values: F64 | F32, sigma_px: float) -> F64 | F32:
    """Smooth the last two axes, in float64; a stack of maps map by map, and kept in float32."""
    if values.ndim == 2:
        smooth: F64 = gaussian_filter(values.astype(np.float64), sigma_px, mode="nearest")
        return smooth
    found = np.empty(values.shape, np.float32)
    for one, target in zip(values, found, strict=True):
        target[:] = _smooth(one, sigma_px)
    return found
