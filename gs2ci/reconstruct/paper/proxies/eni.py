"""ENI, energy-normalised initialisation: every view from its own samples of the normalised measurement.

Here: the normalisation, each view's samples and their completion (paper, eq. 2; supplement, eqs. 3 and 4); beside it,
for comparison, the measurement behind each mask. Not here:
when ENI is the right choice (`gs2ci.reconstruct.paper.proxies.routing`).
"""

from functools import partial
from typing import Final

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.ndimage import distance_transform_edt
from scipy.spatial import Delaunay, QhullError

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.paper.proxies.planes import coded_planes
from gs2ci.reconstruct.threads import in_threads

_Mask = Bool

# A pixel counts as open under a grey mask, and as a sample of its view, from half of the mask's open level on. The open
# level is a high percentile and not the maximum, so that one bright calibration pixel cannot change it.
_OPEN_SHARE: Final = 0.5
_OPEN_PERCENTILE: Final = 99.0


def energy_normalised_views(shot: Shot) -> F32:
    """Estimate each view from the pixels that its mask opens.

    The measurement is divided by its total transmission a = Σ wᵢ Mᵢ; where mask i is open, the quotient is a sample
    of view i. Between samples the view is linear on their Delaunay triangles; outside their convex hull, and if they
    span no triangle, it is the nearest sample.

    Args:
        shot: A checked shot: RGB, mono or mosaic; binary or grey masks. A mosaic's colours are completed each from
            its own pixels; saturated pixels are no samples.

    Returns:
        Views, [N, H, W, C] float32, full scale 1, not clamped. A view without any sample (its mask is closed, or its
        weight is 0) is completed from the samples of all views.

    Raises:
        InputError: No pixel that counts is open in any mask.
    """
    planes = coded_planes(shot)
    views = np.empty((shot.views, *shot.size, shot.channels), np.float32)
    for plane in planes:
        exposure = plane.transmissions.sum(axis=0)
        if not exposure.any():
            raise InputError(
                "no unsaturated pixel of the measurement is open in any mask",
                allowed="at least one in each colour",
                remedy="check the masks' order and registration, and the saturation level",
            )
        normalised = plane.measured / np.where(exposure > 0, exposure, 1)[..., None]
        samples = [_samples(transmission, exposure > 0) for transmission in plane.transmissions]
        for i, view in enumerate(in_threads(partial(complete, normalised), samples)):
            views[i, :, :, plane.channels] = view
    return views


def masked_measurements(shot: Shot) -> F32:
    """Multiply the measurement by each transmission wᵢ Mᵢ: the naive proxy of the paper's table S-II, Y ⊙ Mᵢ.

    It exists for comparison: the light of the views is still mixed, and each shows the pattern of a mask.

    Args:
        shot: A checked shot. A mosaic's colours are completed before, each from its own pixels; saturated pixels are
            completed as well, from their neighbours.

    Returns:
        [N, H, W, C] float32, full scale of one view 1, not clamped: where several masks are open their views add up.
        A colour of which no pixel is open in any mask is dark.
    """
    transmissions = shot.masks.astype(np.float64) * shot.weights.astype(np.float64)[:, None, None]
    views = np.zeros((shot.views, *shot.size, shot.channels), np.float32)
    for plane in coded_planes(shot):
        seen = plane.transmissions.sum(axis=0) > 0
        if not seen.any():
            continue
        # A pixel that no mask opens carries no information, and no mask transmits it.
        measured = complete(plane.measured, seen)
        views[..., plane.channels] = transmissions[..., None] * measured
    return views


def complete(values: F64, known: _Mask) -> F64:
    """Fill the unknown pixels of an image: linearly inside the convex hull of the known ones, nearest outside.

    Args:
        values: [H, W, C]; read where `known` only.
        known: [H, W] bool, at least one True.

    Returns:
        [H, W, C], equal to `values` where known.

    If four samples on a circle leave the triangulation ambiguous, Qhull's choice is used.
    """
    if known.all():
        return values.copy()
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    filled: F64 = values[tuple(nearest)]
    points, missing = np.argwhere(known).astype(np.float64), np.argwhere(~known)
    try:
        triangles = Delaunay(points)
    except (QhullError, ValueError):  # fewer than three samples, or all of them on one line: the hull has no inside
        return filled
    linear = LinearNDInterpolator(triangles, values[known])(missing)
    inside = np.isfinite(linear).all(axis=1)  # outside the hull the interpolator answers NaN
    filled[tuple(missing[inside].T)] = linear[inside]
    return filled


def _samples(transmission: F64, counts: _Mask) -> _Mask:
    """Find the pixels that a mask opens; all that count if it opens none."""
    light = transmission[transmission > 0]
    if not light.size:
        return counts
    samples: _Mask = transmission >= _OPEN_SHARE * np.percentile(light, _OPEN_PERCENTILE)
    return samples
