"""Which proxy for which masks: the multiplicity and the rule (paper, eq. 3).

Here: the rule, the fallback if it cannot be followed, and the choice of decoded views instead. Not here: the
constructions (`eni`, `amdi`); the naive one exists for comparison and is never chosen.
"""

from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code, Finding, Findings, finding
from gs2ci.core.records import Shot
from gs2ci.reconstruct.paper.proxies.amdi import mask_decoded_views
from gs2ci.reconstruct.paper.proxies.eni import energy_normalised_views, masked_measurements

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


def multiplicity_error(shot: Shot) -> float:
    """Return the standard error of `multiplicity`, if each pixel's sum of transmissions were drawn independently."""
    sums = np.tensordot(shot.weights.astype(np.float64), shot.masks, 1)
    return float(sums.std() / np.sqrt(sums.size))


def route(shot: Shot) -> ProxyMethod:
    """Choose by the masks alone: ENI below a multiplicity of 4, AMDI from it on, within sampling error.

    Args:
        shot: With its calibrated masks: pixels closed later (held out, dead, hot) would make the multiplicity smaller
            than that of the masks' design.
    """
    slack = max(_SAMPLING_ERRORS * multiplicity_error(shot), 1e-9)
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
