"""Views combined of several: the convex combination that explains the held-out pixels best.

A scene errs where the world is not as its model says, a decode where the masks leave it blind; where both err as much,
the mean of the two errs less than either. Shares that are not negative and add up to one, fitted on the pixels that
none of them saw, find that out; few pixels suffice for two numbers.
Here: the shares, and the sum. Not here: what is combined, and whether the simpler one stands (`pipeline`).
"""

from collections.abc import Mapping
from typing import Final, TypeVar

import numpy as np
from scipy.optimize import nnls

from gs2ci.core.arrays import F32
from gs2ci.reconstruct.measurement.jury import Jury

Name = TypeVar("Name", bound=str)

# A share that is smaller than this is not worth a decode.
_LEAST_SHARE: Final = 0.05
# How much more than all residuals together it weighs that shares add up to one.
_SUM_WEIGHT: Final = 1e3


def shares(jury: Jury, candidates: Mapping[Name, F32]) -> dict[Name, float]:
    """Return the share of each candidate in the combination that explains the held-out pixels best.

    Args:
        jury: The measurement, and its held-out pixels.
        candidates: Views, [N, H, W, C] each, that were found without those pixels; the first stands alone where no
            pixel was held out or nothing can be computed.

    Returns:
        Shares from 0 to 1 that add up to 1; small ones are 0.
    """
    names = list(candidates)
    alone = {name: float(name == names[0]) for name in names}
    if not jury.heldout.any():
        return alone
    predicted = np.stack([jury.coded(candidates[name])[jury.heldout].ravel() for name in names], 1).astype(np.float64)
    measured = jury.shot.measurement[jury.heldout].ravel().astype(np.float64)
    size = float(np.linalg.norm(measured))
    if size == 0 or not np.isfinite(predicted).all():
        return alone
    system = np.vstack([predicted / size, np.full(len(names), _SUM_WEIGHT)])
    found, _ = nnls(system, np.append(measured / size, _SUM_WEIGHT))
    found[found < _LEAST_SHARE * found.sum()] = 0.0
    return dict(zip(names, (found / found.sum()).tolist(), strict=True))


def combined(candidates: Mapping[Name, F32], parts: Mapping[Name, float]) -> F32:
    """Return the sum of candidates, [N, H, W, C] each, by their shares; those without a share need not be there."""
    (first, share), *others = ((name, share) for name, share in parts.items() if share > 0)
    total: F32 = np.float32(share) * candidates[first]
    for name, share in others:
        total += np.float32(share) * candidates[name]
    return total
