"""Which proxy for which masks: the multiplicity and the rule (paper, eq. 3).

Here: the rule, what happens when it cannot be kept, and the decoded views instead. Not here: the two constructions
(`eni`, `amdi`).
"""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.records import Shot
from gs2ci.reconstruct.choices import ProxyName
from gs2ci.reconstruct.decode.proxies.amdi import mask_decoded_views
from gs2ci.reconstruct.decode.proxies.eni import energy_normalised_views

ProxyMethod = Literal["eni", "amdi"]

# τ_μ: from so many views in a pixel on, a normalised sample is a mixture and no longer a view.
MULTIPLICITY_THRESHOLD: Final = 4.0


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


def route(shot: Shot) -> ProxyMethod:
    """Choose by the masks alone: ENI below a multiplicity of 4, AMDI from it on."""
    return "eni" if multiplicity(shot) < MULTIPLICITY_THRESHOLD else "amdi"


def build_proxies(shot: Shot, method: ProxyMethod | Literal["auto"] = "auto") -> Proxies:
    """Make the proxy views of a shot.

    Args:
        shot: A checked shot.
        method: One of the two, or `auto` for the one that the masks ask for. Where `auto` asks for AMDI and the
            masks do not tell the views apart (equal or all-open masks), ENI stands in, and `note` says so.

    Raises:
        InputError: An unknown method; AMDI was asked for by name and the masks do not allow it; no pixel of the
            measurement counts.
    """
    if method not in ("auto", "eni", "amdi"):
        raise InputError(f"proxy method {method!r}", allowed="auto, eni, amdi")
    chosen, note = route(shot) if method == "auto" else method, None
    if chosen == "amdi":
        try:
            views = mask_decoded_views(shot).views
        except InputError as error:
            if method == "amdi":
                raise
            chosen, note = "eni", finding(Code.PROXIES_BY_ENERGY, problem=error.problem)
    if chosen == "eni":
        views = energy_normalised_views(shot)
    return Proxies(np.clip(views, 0, 1), chosen, multiplicity(shot), note)


def geometry_views(seen: Shot, decoded: F32, proxy: ProxyName) -> F32:
    """Return the views that the geometry stage looks at, [N, H, W, C].

    Args:
        seen: The measurement as far as it may be seen.
        decoded: Its views as GAP-TV decodes them.
        proxy: Which views are wanted.

    Raises:
        InputError: The masks do not allow the proxies that are wanted.
    """
    return decoded if proxy == "gap-tv" else build_proxies(seen, proxy).views
