"""Which share of the picture does not move during the exposure, from the measurement and its masks alone.

Each block of the picture is at rest or moves by some pixels, as its displacement and its standard error say
(`displacements`); the share of those at rest is estimated by maximum likelihood. A plain block, or a noisy one, changes
neither side. Of a camera that moves, hardly any block is at rest.

Here: that share. Not here: what follows from it (`gs2ci.reconstruct.geometry.choose`).
"""

from typing import Final

import numpy as np
from scipy.special import expit, logit

from gs2ci.core.arrays import F64
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.blocks import ridged
from gs2ci.reconstruct.measurement.displacements import FIRST_ORDER_PX, BlockDisplacements, displacements

# One that moves does so by about one of these, px over the exposure.
_MOVING_PX: Final = (1.0, 2.5, 6.0)
# The natural logarithm of the likelihood ratio against a picture without any block at rest, and the share of blocks at
# rest, from which on it is believed (`python -m tests.benchmarks at_rest`).
_LEAST_EVIDENCE: Final = 12.0
_LEAST_SHARE: Final = 0.3
# The smooth field settles within so many steps.
_FIELD_STEPS: Final = 10


def share_at_rest(shot: Shot) -> float:
    """Return the share of the picture that surely does not move, 0 to 1; 0 if the measurement does not tell.

    It is 0, too, if the displacements form a smooth field, as before a camera that circles a flat object or moves by a
    pixel: parts of the picture are then at rest by chance.

    Args:
        shot: The measurement; closed masks mark pixels that are not to be read.
    """
    displaced = displacements(shot)
    if displaced is None:
        return 0.0
    share, evidence = _likeliest_share(displaced, 0.0)
    if evidence < _LEAST_EVIDENCE or share < _LEAST_SHARE:
        return 0.0
    places = displaced.centres_px / shot.size[::-1] * 2 - 1
    return 0.0 if _moves_smoothly(displaced, places, share, evidence) else share


def _likeliest_share(displaced: BlockDisplacements, expected: F64 | float) -> tuple[float, float]:
    """Return the likeliest share of blocks that move as expected, [B, K], and its evidence.

    The evidence is the natural logarithm of the likelihood ratio against no such block.
    """
    shares = np.linspace(0, 1, 101)
    ratio = np.exp(np.clip(_log_ratio(displaced, expected), -700, 700))
    evidence = np.log1p(np.maximum(shares[:, None] * (ratio - 1), np.finfo(np.float64).eps - 1)).sum(axis=1)
    best = int(np.argmax(evidence))
    return float(shares[best]), float(evidence[best])


def _moves_smoothly(displaced: BlockDisplacements, places: F64, share: float, evidence: float) -> bool:
    """Tell whether a smooth field of displacements is clearly likelier than a share at rest with this evidence.

    The field is quadratic in the places, [B, 2] from -1 to 1, and uniform over time. Its parameters count as in
    Schwarz's criterion (BIC).
    """
    x, y = places.T
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    weights = np.linalg.inv(displaced.covariance + np.eye(displaced.px.shape[1]) * FIRST_ORDER_PX**2)
    # The design of one block: its two displacements of even motion, by the parameters along x, then along y.
    design = np.zeros((len(x), displaced.px.shape[1], 2 * basis.shape[1]))
    design[:, 0, : basis.shape[1]] = design[:, 1, basis.shape[1] :] = basis
    weighted = design.swapaxes(1, 2) @ weights
    grams, moments = weighted @ design, (weighted @ displaced.px[..., None])[..., 0]
    penalty = 0.5 * design.shape[2] * np.log(len(x))
    # From all blocks at first, then from those that move so.
    belongs = np.ones(len(x))
    for _ in range(_FIELD_STEPS):
        gram = ridged(np.tensordot(belongs, grams, axes=1))
        field = design @ np.linalg.solve(gram, belongs @ moments)
        share, found = _likeliest_share(displaced, field)
        if found > evidence + penalty:
            return True
        belongs = expit(_log_ratio(displaced, field) + logit(np.clip(share, 0.01, 0.99)))
    return False


def _log_ratio(displaced: BlockDisplacements, expected: F64 | float) -> F64:
    """Return by how much likelier blocks move as expected, [B, K], than anyhow (natural logarithm, [B])."""
    as_expected = _log_likelihood(displaced.px - expected, displaced.covariance, FIRST_ORDER_PX)
    anyhow = [_log_likelihood(displaced.px, displaced.covariance, size) for size in _MOVING_PX]
    return as_expected - np.logaddexp.reduce(anyhow) + np.log(len(_MOVING_PX))


def _log_likelihood(found: F64, covariance: F64, size_px: float) -> F64:
    """Return the logarithm of the density of displacements, [B], of about this size, but for a constant."""
    spread = covariance + np.eye(found.shape[1]) * size_px**2
    distance = np.einsum("bi,bi->b", found, np.linalg.solve(spread, found[..., None])[..., 0])
    return -0.5 * (distance + np.linalg.slogdet(spread)[1])
