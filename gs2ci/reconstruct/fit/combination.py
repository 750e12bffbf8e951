"""Views combined of several: the convex combination that is expected to err least.

A scene errs where the world is not as its model says, a decode where the masks leave it blind; where both err as much,
the mean of the two errs less than either. What each errs by is told by pixels that none of them saw. But what is handed
over is found from all pixels, and differs there: with its own reading known, a view no longer errs along that
pixel's masks, and takes over that reading's noise. So the held-out pixels' residual, and by how much they change once
they are seen, give the error of the views as they are handed over.

With e_j = truth − blind views of candidate j at a held-out pixel, [N], its residual r_j = M·e_j + noise, and
d_j = full − blind views there, the errors of full views have the expected products

    ⟨(e_j − d_j)·(e_k − d_k)⟩ ≈ ⟨ N r_j r_k − r_j (M·d_k) − r_k (M·d_j) + (a_j + a_k) σ² ⟩ / |M|² + ⟨d_j·d_k⟩,

where errors are taken to be alike in all views (e·d ≈ (M·e)(M·d)/|M|²), a_k is the share of its own reading's residual
that candidate k takes over, and σ² is the power of the noise; N σ²/|M|² is left out, being the same for all.
Here: these products, the shares and the sum. Not here: the candidates (`reconstruct.handing_over`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final, TypeVar

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.measurement.jury import Jury

Name = TypeVar("Name", bound=str)

# A share that is smaller than this is chance.
_LEAST_SHARE: Final = 0.05
# A fit follows some of the noise, so that less is left of it where the fit has seen it.
_FOLLOWED: Final = 1.1
# Half of all normal deviates are smaller than this. The median residual tells the noise, since a model that is wrong in
# places leaves much in those places only.
_MEDIAN_DEVIATE: Final = 0.6745


@dataclass(frozen=True)
class Candidate:
    """Views that may be handed over, [N, H, W, C] each.

    Args:
        blind: Found without the held-out pixels.
        full: Found in the same way from all pixels.
    """

    blind: F32
    full: F32


def noise_power(jury: Jury, views: F32) -> float:
    """Return the power of the measurement's noise, at most, told by what views of a scene leave of pixels they saw.

    Args:
        jury: The measurement.
        views: Of a scene, which cannot follow the noise of single pixels, [N, H, W, C].

    Returns:
        In squared units of the measurement; 0 where no pixel can tell.
    """
    asked = jury.shot.lit & ~jury.heldout
    if jury.shot.saturated is not None:
        asked &= ~jury.shot.saturated
    if not asked.any():
        return 0.0
    left = (jury.shot.measurement - jury.coded(views))[asked].astype(np.float64)
    return _FOLLOWED * float(np.median(np.abs(left)) / _MEDIAN_DEVIATE) ** 2


def expected_products(jury: Jury, candidates: Sequence[Candidate], noise: float) -> F64:
    """Return the expected products of the candidates' errors, [J, J], up to one number that is the same for all.

    Args:
        jury: The measurement, and its held-out pixels, of which there is at least one.
        candidates: J of them.
        noise: Power of the measurement's noise; bounded by what the candidates leave of pixels that none has seen.

    Returns:
        Summed over the views, per pixel and channel.
    """
    heldout = jury.heldout
    weighted = (jury.shot.weights[:, None, None] * jury.shot.masks)[:, heldout].astype(np.float64)
    light = (weighted**2).sum(axis=0)  # |M|², [K]
    residuals = [_at(jury, jury.shot.measurement - jury.coded(one.blind)) for one in candidates]
    noise = min(noise, *(float(np.mean(residual**2)) for residual in residuals))
    changes = [(one.full - one.blind)[:, heldout].astype(np.float64) for one in candidates]
    coded = [_at(jury, jury.coded(one.full - one.blind)) for one in candidates]
    # Behind a colour filter array one of three channels is read, and changes by its own reading.
    read = residuals[0].shape[1] / changes[0].shape[2]
    taken = [_share_taken(change, residual) for change, residual in zip(coded, residuals, strict=True)]

    def product(j: int, k: int) -> float:
        blind = len(weighted) * np.mean(residuals[j] * residuals[k], axis=1)
        seen = np.mean(residuals[j] * coded[k] + residuals[k] * coded[j], axis=1) - (taken[j] + taken[k]) * noise
        both = np.mean(changes[j] * changes[k], axis=2).sum(axis=0)
        return float(np.mean((blind - read * seen) / light + both))

    count = range(len(candidates))
    return np.array([[product(j, k) for k in count] for j in count])


def expected_rms(jury: Jury, views: Candidate, noise: float) -> float | None:
    """Return by how much views are expected to err, root mean square over all pixels, views and channels.

    As above with what is the same for all: N σ²/|M|². A pixel that no mask opens has no reading to be known by, and
    errs like one whose reading was held out. Fits follow noise, of which too little is then taken off: about right
    where there is little of it, and too much where there is more.

    Args:
        jury: The measurement, and its held-out pixels.
        views: Those that are handed over.
        noise: Power of the measurement's noise, as by `noise_power`.

    Returns:
        In full scales of one view; None where no pixel was held out, or the views are not finite.
    """
    if not jury.heldout.any() or not _is_finite(views):
        return None
    weighted = (jury.shot.weights[:, None, None] * jury.shot.masks)[:, jury.heldout].astype(np.float64)
    blind = Candidate(views.blind, views.blind)
    left = _at(jury, jury.shot.measurement - jury.coded(views.blind))
    least = min(noise, float(np.mean(left**2))) * len(weighted) * float(np.mean(1 / (weighted**2).sum(axis=0)))
    seen, unseen = (max(0.0, float(expected_products(jury, [one], noise)[0, 0]) - least) for one in (views, blind))
    lit = float(jury.shot.lit.mean())
    return float(np.sqrt((lit * min(seen, unseen) + (1 - lit) * unseen) / len(weighted)))


def _at(jury: Jury, image: F32) -> F64:
    found: F64 = image[jury.heldout].astype(np.float64)
    return found


def _share_taken(coded: F64, residual: F64) -> float:
    """Return which share of its own reading's residual a candidate takes over."""
    power = float((residual**2).sum())
    return float(np.clip((coded * residual).sum() / power, 0, 1)) if power > 0 else 0.0


def least_on_simplex(products: F64) -> F64:
    """Return the shares, [J], not negative and of sum 1, with the smallest expected error a·Q·a.

    Every set of candidates is tried: the smallest of the stationary points of all faces is the smallest of all, also
    where chance has made the products indefinite.

    Args:
        products: Q, [J, J], symmetric.
    """
    count = len(products)
    best: F64 = np.eye(count)[int(np.argmin(np.diag(products)))]
    least = float(np.diag(products).min())
    for size in range(2, count + 1):
        for chosen in combinations(range(count), size):
            part = products[np.ix_(chosen, chosen)]
            system = np.block([[part, -np.ones((size, 1))], [np.ones((1, size)), np.zeros((1, 1))]])
            try:
                found = np.linalg.solve(system, np.append(np.zeros(size), 1.0))[:size]
            except np.linalg.LinAlgError:
                continue
            error = float(found @ part @ found)
            if found.min() >= 0 and error < least:
                best, least = np.zeros(count), error
                best[list(chosen)] = found
    return best


def shares(jury: Jury, candidates: Mapping[Name, Candidate], noise: float) -> dict[Name, float]:
    """Return the share of each candidate in the combination that is expected to err least.

    Args:
        jury: The measurement, and its held-out pixels.
        candidates: By name; those that are not finite get no share. The first stands alone where no pixel was held out.
        noise: Power of the measurement's noise, as by `noise_power`.

    Returns:
        Shares from 0 to 1 that add up to 1; small ones are 0.
    """
    names = list(candidates)
    usable = [name for name in names if _is_finite(candidates[name])]
    found = dict.fromkeys(names, 0.0)
    if not jury.heldout.any() or not usable:
        return {**found, names[0]: 1.0}
    least = least_on_simplex(expected_products(jury, [candidates[name] for name in usable], noise))
    least[least < _LEAST_SHARE] = 0.0
    return {**found, **dict(zip(usable, (least / least.sum()).tolist(), strict=True))}


def _is_finite(candidate: Candidate) -> bool:
    return bool(np.isfinite(candidate.blind).all() and np.isfinite(candidate.full).all())


def combined(candidates: Mapping[Name, F32], parts: Mapping[Name, float]) -> F32:
    """Return the sum of candidates, [N, H, W, C] each, by their shares; those without a share need not be there."""
    (first, share), *others = ((name, share) for name, share in parts.items() if share > 0)
    total: F32 = np.float32(share) * candidates[first]
    for name, share in others:
        total += np.float32(share) * candidates[name]
    return total
