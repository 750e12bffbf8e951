"""How close recovered depth is to the truth, after the scale that no image can reveal is removed.

Here: the errors of depth maps. Not here: files, camera paths (`gs2ci.evaluate.trajectory`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, Bool
from gs2ci.core.errors import InputError

_CLOSE_RATIO: Final = 1.25  # Eigen, Puhrsch and Fergus (NIPS 2014), section 4.1


@dataclass(frozen=True)
class DepthErrors:
    """Errors of depth maps over the pixels that both know.

    Args:
        scale: What the estimate was multiplied by: the median ratio of true to estimated depth over all pixels.
        abs_rel: Mean of |estimate − truth| / truth.
        rms: Root mean square of estimate − truth, in the unit of the truth.
        close_share: Share of the pixels where the larger is less than 1.25 times the smaller.
        known_share: Share of the truth's pixels for which the estimate says anything.
    """

    scale: float
    abs_rel: float
    rms: float
    close_share: float
    known_share: float


def depth_errors(estimate: F32, truth: F32) -> DepthErrors | None:
    """Measure the errors of depth along the optical axis (Eigen et al. 2014), after scaling by the median.

    One scale serves all views: it is the scene's. Pixels where either is not above 0 or not finite do not count.

    Args:
        estimate: [N, H, W], in any unit; 0 where nothing is known.
        truth: The same shape, or [H, W] for one view; 0, NaN or infinite where nothing is known.

    Returns:
        The errors; None where no pixel is known to both.

    Raises:
        InputError: The shapes differ.
    """
    if truth.ndim == 2:
        truth = truth[None]
    if estimate.shape != truth.shape or estimate.ndim != 3:
        raise InputError(
            f"depth {list(estimate.shape)} cannot be compared with true depth {list(truth.shape)}",
            allowed="two stacks [N, H, W] of one shape",
        )
    wanted = _known(truth)
    both = wanted & _known(estimate)
    if not both.any():
        return None
    true, found = truth[both].astype(np.float64), estimate[both].astype(np.float64)
    scale = float(np.median(true / found))
    error = scale * found - true
    ratio = np.maximum(scale * found / true, true / (scale * found))
    return DepthErrors(
        scale=scale,
        abs_rel=float(np.mean(np.abs(error) / true)),
        rms=float(np.sqrt(np.mean(error**2))),
        close_share=float(np.mean(ratio < _CLOSE_RATIO)),
        known_share=float(both.sum() / wanted.sum()),
    )


def _known(depth: F32) -> Bool:
    return np.isfinite(depth) & (depth > 0)
