"""Whether the depth order of a scene is right, and not reversed (near and far exchanged).

With little parallax in a narrow field of view, a scene inside out (depth order and path reversed) explains a
measurement nearly as well as the right one; its views look right, and so does its path apart from the direction. Here:
the two figures that reveal it, and the sentence that follows from them. Not here: how either error is measured
(`trajectory`, `depth`).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError
from gs2ci.core.ranks import rank_correlation
from gs2ci.evaluate.trajectory import TURNED_OVER_DEG

# With fewer pixels, or with depths that differ by less than this share of them, no order is computed.
_LEAST_PIXELS: Final = 16
_ONE_DEPTH: Final = 1e-3


def depth_rank(estimate: F32 | F64, truth: F32 | F64) -> float | None:
    """Measure the rank correlation (Spearman's) of estimated with true depth, −1 to 1: below 0, the order is reversed.

    Args:
        estimate: Depth along the optical axis, any shape; 0, NaN or infinite at pixels without a depth.
        truth: The same shape.

    Returns:
        None if fewer than 16 pixels have both depths, or if either depth is constant.

    Raises:
        InputError: The shapes differ.
    """
    if estimate.shape != truth.shape:
        raise InputError(
            f"depth {list(estimate.shape)} cannot be compared with true depth {list(truth.shape)}",
            allowed="two maps of one shape",
        )
    both = np.isfinite(estimate) & (estimate > 0) & np.isfinite(truth) & (truth > 0)
    found, true = estimate[both].astype(np.float64), truth[both].astype(np.float64)
    if found.size < _LEAST_PIXELS or _lies_at_one_depth(found) or _lies_at_one_depth(true):
        return None
    return rank_correlation(found, true)


def inside_out(rotation_deg: float | None, rank: float | None) -> str:
    """Return a sentence if a result is inside out; "" if it is not, or if the truth does not show it.

    Args:
        rotation_deg: `TrajectoryErrors.rotation_deg`; None without a true path.
        rank: `depth_rank`; None without true depth.
    """
    said = []
    if rotation_deg is not None and rotation_deg > TURNED_OVER_DEG:
        said.append(f"the path runs backwards (its centres fit with cameras turned by {rotation_deg:.0f}°)")
    if rank is not None and rank < 0:
        said.append(f"near and far are exchanged (rank correlation of depth {rank:+.2f})")
    return f"inside out: {' and '.join(said)}" if said else ""


def _lies_at_one_depth(depth: F64) -> bool:
    return bool(np.ptp(depth) <= _ONE_DEPTH * np.median(depth))
