"""Which proxy for which masks: the multiplicity and the rule (paper, eq. 3).

Here: the rule, the fallback if it cannot be followed, and the choice of decoded views instead. Not here: the
constructions (`amdi`); the naive one exists for comparison and is never chosen.
"""

from dataclasses import dataclass
from functools import partial
from typing import Final, Literal, get_args

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.ndimage import distance_transform_edt
from scipy.spatial import Delaunay, QhullError

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code, Finding, Findings, finding
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import white_reading
from gs2ci.reconstruct.paper.proxies.amdi import mask_decoded_views
from gs2ci.reconstruct.paper.proxies.planes import coded_planes
from gs2ci.reconstruct.threads import in_threads

# ENI, energy-normalised initialisation: every view from its own samples of the normalised measurement.


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


def complete(values: F64, known: Bool) -> F64:
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


def _samples(transmission: F64, counts: Bool) -> Bool:
    """Find the pixels that a mask opens; all that count if it opens none."""
    light = transmission[transmission > 0]
    if not light.size:
        return counts
    return transmission >= _OPEN_SHARE * np.percentile(light, _OPEN_PERCENTILE)


ProxyMethod = Literal["naive", "eni", "amdi"]

# τ_μ: from so many views in a pixel on, a normalised sample is a mixture of views and no longer a sample of one.
MULTIPLICITY_THRESHOLD: Final = 4.0
# Random masks that open a quarter of 16 views have a multiplicity of 4 by design, but of 3.9988, say, by their draw.
# The paper uses AMDI for that setting. So a multiplicity below τ_μ by at most so many standard errors of a mean over
# independently drawn pixels counts as τ_μ. (This is ours: the paper does not state what happens at the threshold.)
_SAMPLING_ERRORS: Final = 3.0


@dataclass(frozen=True)
class Proxies:
    """Proxy views and how they were made.

    Args:
        views: [N, H, W, C] float32 in [0, 1]. For geometry only: never a photometric target.
        method: The method that made them.
        multiplicity: Mean number of views in a pixel of the measurement.
        note: Why the method is not the one that the multiplicity selects; None if it is.
    """

    views: F32
    method: ProxyMethod
    multiplicity: float
    note: Finding | None = None


def multiplicity(shot: Shot) -> float:
    """Measure μ, the mean over all pixels of Σ wᵢ Mᵢ: how many views share a pixel of the measurement."""
    return float(np.tensordot(shot.weights.astype(np.float64), shot.masks.astype(np.float64).mean(axis=(1, 2)), 1))


def route(shot: Shot) -> ProxyMethod:
    """Choose by the masks alone: ENI below a multiplicity of 4, AMDI from it on, within sampling error.

    Args:
        shot: With its calibrated masks: pixels closed later (held out, dead, hot) would make the multiplicity smaller
            than that of the masks' design.
    """
    sums = white_reading(shot)
    # The multiplicity's standard error, if each pixel's sum of transmissions were drawn independently.
    error = float(sums.std() / np.sqrt(sums.size))
    slack = max(_SAMPLING_ERRORS * error, 1e-9)
    return "eni" if multiplicity(shot) < MULTIPLICITY_THRESHOLD - slack else "amdi"


def build_proxies(shot: Shot, method: ProxyMethod | Literal["auto"] = "auto", masks_of: Shot | None = None) -> Proxies:
    """Make the proxy views of a shot.

    Args:
        shot: A checked shot.
        method: One of the three, or `auto`, which selects ENI or AMDI by the masks. If it selects AMDI and the masks do
            not distinguish the views (equal or all-open masks), ENI is used instead, and `note` says so.
        masks_of: The shot whose masks `auto` uses, if those of `shot` have been closed over some pixels.

    Raises:
        InputError: An unknown method; AMDI was requested by name and the masks do not allow it; no pixel of the
            measurement counts.
    """
    if method not in ("auto", *get_args(ProxyMethod)):
        raise InputError(f"proxy method {method!r}", allowed=", ".join(("auto", *get_args(ProxyMethod))))
    chosen, note = route(masks_of or shot) if method == "auto" else method, None
    if chosen == "amdi":
        try:
            views = mask_decoded_views(shot).views
        except InputError as error:
            if method == "amdi":
                raise
            chosen, note = "eni", finding(Code.PROXIES_BY_ENERGY, problem=error.problem)
    if chosen == "eni":
        views = energy_normalised_views(shot)
    elif chosen == "naive":
        views = masked_measurements(shot)
    return Proxies(np.clip(views, 0, 1), chosen, multiplicity(masks_of or shot), note)


def geometry_views(seen: Shot, proxy: ProxyMethod | Literal["routed"], masks_of: Shot) -> tuple[F32, Findings]:
    """Return the views for the geometry stage, [N, H, W, C], and the findings about them.

    Args:
        seen: The measurement without its held-out pixels.
        proxy: Which proxies are requested.
        masks_of: The measurement with its calibrated masks, which select the proxy.

    Raises:
        InputError: The masks do not allow the requested proxies.
    """
    proxies = build_proxies(seen, "auto" if proxy == "routed" else proxy, masks_of)
    chosen = finding(Code.PROXIES_CHOSEN, method=proxies.method.upper(), multiplicity=proxies.multiplicity)
    return proxies.views, (chosen,) if proxies.note is None else (chosen, proxies.note)
