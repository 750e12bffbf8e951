"""Views combined from several candidates: the convex combination with the smallest expected error.

A scene errs where the world differs from its model, a decode where the masks pass no information; if their errors are
about equal and independent, the mean of the two errs less than either. The error of each candidate is estimated at
pixels that none of them saw. But the delivered views are computed from all pixels, and differ there: with its own
reading known, a pixel no longer errs along its masks, but takes over the noise of that reading. So the error of the
delivered views follows from the residuals at the held-out pixels and from how much the views change there once these
pixels are seen.

With e_j = truth − blind views of candidate j at a held-out pixel, [N], its residual r_j = M·e_j + noise, and
d_j = full − blind views there, the errors of full views have the expected products

    ⟨(e_j − d_j)·(e_k − d_k)⟩ ≈ ⟨ N r_j r_k − r_j (M·d_k) − r_k (M·d_j) + (a_j + a_k) σ² ⟩ / |M|²
                                + ⟨d_j·d_k⟩ − (c_j + c_k) ⟨d_j·d_k − (M·d_j)(M·d_k)/|M|²⟩,

where errors are assumed to be equally large and independent in all views (e·d ≈ (M·e)(M·d)/|M|²), a_k is the share of
its own reading's residual that candidate k takes over, and σ² is the power of the noise; N σ²/|M|² is left out, since
it is the same for all.

The last term is the gain from a reading in the directions across its masks, which the reading itself does not measure:
a decode adds it from its model of pictures. The change of an estimate that has gained is not correlated with the error
that remains (the orthogonality principle), so that e·d = d·d there; the part of a change that follows noise is an
error. Of a residual, the share c = 1 − σ²/⟨r²⟩ is not noise, and the same share of the change is a gain.

A pixel that no mask opens, or whose reading is clipped, errs in the full views as one whose reading is held out: all
terms that follow from a change count by the share of the other pixels.

The reading of a pixel behind masks of which none is open says next to nothing about the views, however large r²/|M|²
is there: what is derived from readings, the gain included, has the weight (|M|²/m²)² in each pixel, at most 1, where m
is the transmission of an open mask. The change ⟨d·d⟩ itself is known in all pixels alike: behind masks that were
calibrated with noise, views change most where no mask is open, by a residual divided by the noise of the masks.

If things move in a way that a scene cannot follow, its fit reproduces the sum of the views but not each view: its
errors cancel along the views, and the held-out residual is smaller than these errors warrant. With covariance
1 − 11ᵀ/N along the views, r² measures |M|² − (Σ M)²/N instead of |M|²: half of it behind masks that are half open. The
residuals of such candidates are therefore scaled by √(|M|²/(|M|² − (Σ M)²/N)), without scaling the noise in them.

Here: these products, the weights (called shares) and the sum. Not here: the candidates (`reconstruct.fusion`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final, TypeVar

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.measurement.holdout import Holdout

Name = TypeVar("Name", bound=str)

# If all masks are about equally open at a pixel, the residual hardly shows such errors and cannot tell their size: this
# bounds the correction.
_LEAST_SHOWN: Final = 0.25
# A view whose mask has less than this share of the largest weight leaves no trace in the readings: a reading cannot
# improve it, and its change, however large, is no gain.
_LEAST_WEIGHT: Final = 0.01
# Smaller shares are chance, and set to 0.
LEAST_SHARE: Final = 0.05


@dataclass(frozen=True)
class Candidate:
    """A candidate for the delivered views, [N, H, W, C] each.

    Args:
        blind: Computed without the held-out pixels.
        full: Computed in the same way from all pixels.
        cancels: Whether its errors cancel along the views, as those of a scene that cannot follow moving things.
    """

    blind: F32
    full: F32
    cancels: bool = False


def expected_products(holdout: Holdout, candidates: Sequence[Candidate], noise: float) -> F64:
    """Return the expected products of the candidates' errors, [J, J], up to one number that is the same for all.

    Args:
        holdout: The measurement, and its held-out pixels, of which there is at least one.
        candidates: J of them.
        noise: Power of the measurement's noise; it is bounded here by the candidates' residuals at held-out pixels.

    Returns:
        Summed over the views, per pixel and channel.
    """
    weighted = holdout.weighted.astype(np.float64)
    light = (weighted**2).sum(axis=0)  # |M|², [K]
    pixel_weights = _pixel_weights(weighted)
    measured = holdout.shot.weights >= _LEAST_WEIGHT * holdout.shot.weights.max()  # [N]
    noise = min(noise, *(_power(holdout.residual_at_pixels(one.blind)) for one in candidates))
    seen = [_Seen.of(holdout, one, noise) for one in candidates]
    hidden = _hidden(weighted)  # [K]
    worth = [hidden if one.cancels else np.ones_like(hidden) for one in candidates]
    known = float(holdout.shot.usable.mean())
    # With a colour filter array each pixel reads one of three channels, and only that one changes by its own reading.
    read = seen[0].residual.shape[1] / seen[0].change.shape[2]

    def product(j: int, k: int) -> float:
        one, other, worths = seen[j], seen[k], worth[j] * worth[k]
        blind = len(weighted) * (worths * np.mean(one.residual * other.residual, axis=1) - (worths - 1) * noise)
        crossed = worth[j][:, None] * one.residual * other.coded + worth[k][:, None] * other.residual * one.coded
        gained = np.mean(crossed, axis=1) - (one.taken + other.taken) * noise
        by_view = np.mean(one.change * other.change, axis=2)  # [N, K]
        both = by_view.sum(axis=0)
        across = by_view[measured].sum(axis=0) - read * np.mean(one.coded * other.coded, axis=1) / light
        by_readings = np.average((blind - known * read * gained) / light, weights=pixel_weights)
        return float(by_readings + known * np.mean(both - (one.learned + other.learned) * pixel_weights * across))

    count = range(len(candidates))
    return np.array([[product(j, k) for k in count] for j in count])


@dataclass(frozen=True)
class _Seen:
    """A candidate at the held-out pixels, before and after it is given their readings.

    Args:
        residual: Before, r, [K, C].
        change: Of its views, d, [N, K, C].
        coded: This change through the masks, M·d, [K, C].
        taken: The share of its own reading's residual that it takes over, a.
        learned: The share of its change across the masks that is a gain, c.
    """

    residual: F64
    change: F64
    coded: F64
    taken: float
    learned: float

    @classmethod
    def of(cls, holdout: Holdout, candidate: Candidate, noise: float) -> "_Seen":
        residual = holdout.residual_at_pixels(candidate.blind)
        step = holdout.at_pixels(candidate.full).astype(np.float64) - holdout.at_pixels(candidate.blind)
        coded = holdout.coded_at_pixels(candidate.full) - holdout.coded_at_pixels(candidate.blind)
        power = _power(residual)
        taken = float(np.clip(np.mean(coded * residual) / power, 0, 1)) if power > 0 else 0.0
        learned = 1 - noise / power if power > 0 else 1.0
        return cls(residual, step, coded, taken, learned)


def expected_rms(holdout: Holdout, views: Candidate, noise: float) -> float | None:
    """Return the expected error of views, root mean square over all pixels, views and channels.

    It is the expected product above plus the term N σ²/|M|² left out there. Fits follow noise, so too little noise is
    subtracted: the result is about right if there is little noise, and too large if there is more.

    Args:
        holdout: The measurement, and its held-out pixels.
        views: The delivered views.
        noise: Mean power of the measurement's noise (`measurement.noise`).

    Returns:
        In full scales of one view; None if no pixel was held out, or the views are not finite.
    """
    if not holdout.pixels.any() or not _is_finite(views):
        return None
    weighted, blind = holdout.weighted.astype(np.float64), Candidate(views.blind, views.blind)
    spread = np.average(1 / (weighted**2).sum(axis=0), weights=_pixel_weights(weighted))
    least = min(noise, _power(holdout.residual_at_pixels(views.blind))) * len(weighted) * float(spread)
    seen, unseen = (max(0.0, float(expected_products(holdout, [one], noise)[0, 0]) - least) for one in (views, blind))
    return float(np.sqrt(min(seen, unseen) / len(weighted)))


def _hidden(weighted: F64) -> F64:
    """Return by what factor residuals at pixels, [K], understate errors that cancel along the views; masks: [N, K]."""
    light = (weighted**2).sum(axis=0)
    shown = light - weighted.sum(axis=0) ** 2 / len(weighted)
    return np.sqrt(light / np.maximum(shown, _LEAST_SHOWN * light))


def _pixel_weights(weighted: F64) -> F64:
    """Return the weights of pixels, [K], by the light that their masks, [N, K], let through."""
    return np.minimum(1.0, (weighted**2).sum(axis=0) / weighted.max() ** 2) ** 2


def _power(values: F64) -> float:
    return float(np.mean(values**2))


def least_on_simplex(products: F64) -> F64:
    """Return the shares, [J], not negative and of sum 1, with the smallest expected error a·Q·a.

    Every subset of candidates is tried: the smallest of the stationary points of all faces is the global minimum, even
    if chance has made the matrix of products indefinite.

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


def shares(holdout: Holdout, candidates: Mapping[Name, Candidate], noise: float) -> dict[Name, float]:
    """Return the share of each candidate in the combination with the smallest expected error.

    Args:
        holdout: The measurement, and its held-out pixels; those of its repeats judge as well, as none of the candidates
            has seen them.
        candidates: By name; those that are not finite get share 0. If no pixel was held out, the first gets share 1.
        noise: Mean power of the measurement's noise (`measurement.noise`).

    Returns:
        Shares from 0 to 1 with sum 1; small ones are set to 0.
    """
    names = list(candidates)
    usable = [name for name in names if _is_finite(candidates[name])]
    found = dict.fromkeys(names, 0.0)
    if not holdout.pixels.any() or not usable:
        return {**found, names[0]: 1.0}
    every = [one for one in (holdout, *holdout.beside) if one.pixels.any()]
    products = [expected_products(one, [candidates[name] for name in usable], noise) for one in every]
    least = least_on_simplex(np.mean(products, axis=0))
    least[least < LEAST_SHARE] = 0.0
    return {**found, **dict(zip(usable, (least / least.sum()).tolist(), strict=True))}


def _is_finite(candidate: Candidate) -> bool:
    return bool(np.isfinite(candidate.blind).all() and np.isfinite(candidate.full).all())


def combined(candidates: Mapping[Name, F32], parts: Mapping[Name, float]) -> F32:
    """Return the sum of candidates, [N, H, W, C] each, weighted by their shares; those of share 0 may be missing."""
    (first, share), *others = ((name, share) for name, share in parts.items() if share > 0)
    total: F32 = np.float32(share) * candidates[first]
    for name, share in others:
        total += np.float32(share) * candidates[name]
    return total
