"""Which proxy for which masks: the multiplicity and the rule (paper, eq. 3).

Here: the rule, what happens when it cannot be kept, and the decoded views instead. Not here: the constructions (`eni`,
`amdi`, and `naive`, which is only compared with and never chosen).
"""

from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.records import Shot
from gs2ci.reconstruct.choices import ProxyName
from gs2ci.reconstruct.decode.proxies.amdi import mask_decoded_views
from gs2ci.reconstruct.decode.proxies.eni import energy_normalised_views
from gs2ci.reconstruct.decode.proxies.naive import masked_measurements

ProxyMethod = Literal["naive", "eni", "amdi"]

# τ_μ: from so many views in a pixel on, a normalised sample is a mixture and no longer a view.
MULTIPLICITY_THRESHOLD: Final = 4.0
# Random masks of a quarter of 16 views have a multiplicity of 4 by design and of 3.9988, say, by their draw. The paper
# sends that setting to AMDI. So a multiplicity counts as τ_μ that falls short of it by no more than so many standard
# errors of a mean over pixels drawn independently. (Ours: the paper does not say what happens at the threshold.)
_SAMPLING_ERRORS: Final = 3.0


@dataclass(frozen=True)
class Proxies:
    """Proxy views and how they were made.

    Args:
        views: [N, H, W, C] float32 in [0, 1]. For geometry only: never a photometric target.
        method: What made them.
        multiplicity: Mean number of views in a pixel of the measurement.
        note: Why the method is not what the multiplicity asks for; None where it is.
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
        shot: With its masks as they were calibrated. Pixels that were closed since (held out, dead, hot) count for less
            than the masks' design says: close none before asking.
    """
    slack = max(_SAMPLING_ERRORS * multiplicity_error(shot), 1e-9)
    return "eni" if multiplicity(shot) < MULTIPLICITY_THRESHOLD - slack else "amdi"


def build_proxies(shot: Shot, method: ProxyMethod | Literal["auto"] = "auto", masks_of: Shot | None = None) -> Proxies:
    """Make the proxy views of a shot.

    Args:
        shot: A checked shot.
        method: One of the three, or `auto` for that of ENI and AMDI that the masks ask for. Where `auto` asks for AMDI
            and the masks do not tell the views apart (equal or all-open masks), ENI stands in, and `note` says so.
        masks_of: Whose masks `auto` asks, where those of the shot have been closed over some pixels.

    Raises:
        InputError: An unknown method; AMDI was asked for by name and the masks do not allow it; no pixel of the
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


def geometry_views(seen: Shot, decoded: F32, proxy: ProxyName, masks_of: Shot) -> tuple[F32, tuple[Finding, ...]]:
    """Return the views that the geometry stage looks at, [N, H, W, C], and what is to be said of them.

    Args:
        seen: The measurement as far as it may be seen.
        decoded: Its views as GAP-TV decodes them.
        proxy: Which views are wanted.
        masks_of: The measurement with its masks as they were calibrated, which route.

    Raises:
        InputError: The masks do not allow the proxies that are wanted.
    """
    if proxy == "gap-tv":
        return decoded, ()
    proxies = build_proxies(seen, "auto" if proxy == "routed" else proxy, masks_of)
    chosen = finding(Code.PROXIES_CHOSEN, method=proxies.method.upper(), multiplicity=proxies.multiplicity)
    return proxies.views, (chosen,) if proxies.note is None else (chosen, proxies.note)
