"""Errors of recovered depth, after the scale, which no image can determine, is aligned.

Here: the errors of depth maps, and their wording. Not here: files, camera paths (`gs2ci.evaluate.trajectory`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64, Bool, rms_of
from gs2ci.core.cameras import camera_centres
from gs2ci.core.errors import InputError
from gs2ci.core.ranks import rank_correlation
from gs2ci.core.run_figures import Number

_CLOSE_RATIO: Final = 1.25  # Eigen, Puhrsch and Fergus (NIPS 2014), section 4.1
FAR_OFF_PX: Final = 0.25
"""A disparity between neighbouring views that is wrong by more than this means another surface's depth, or none."""
# Depths whose rank correlation with the true ones exceeds this have near and far as they are.
_IN_ORDER: Final = 0.3
# Least absolute deviations by iteratively reweighted least squares: number of iterations, and the share of the spread
# below which errors are weighted equally.
_ROUNDS: Final = 50
_LEVEL_SHARE: Final = 1e-3
# The share of its square below which the variance of a column is no more than rounding.
_CONSTANT: Final = 1e-12


@dataclass(frozen=True)
class DepthErrors:
    """Errors of depth maps over the pixels where both depths are known.

    Args:
        scale: The factor applied to the estimate: the median ratio of true to estimated depth over all pixels.
        abs_rel: Mean of |estimate − truth| / truth.
        median_rel: Median of the same.
        rms: Root mean square of estimate − truth, in the unit of the truth.
        close_share: Share of the pixels where the larger is less than 1.25 times the smaller.
        known_share: Share of the truth's pixels for which the estimate has a depth.
        rank: Rank correlation (Spearman) of estimated and true depth; negative if near and far are exchanged; None if
            either depth is constant.
        median_px: Median error of the disparity between neighbouring views, px, after the affine fit of inverse depths
            with the smallest sum of absolute errors that does not exchange near and far; None if the parallax is not
            known, or if the true depth is constant, which the fit always meets.
        far_off_share: Share of the pixels whose disparity error, after the same fit, exceeds `FAR_OFF_PX`.
    """

    scale: Number
    abs_rel: Number
    median_rel: Number
    rms: Number
    close_share: Number
    known_share: Number
    rank: Number | None
    median_px: Number | None
    far_off_share: Number | None

    @property
    def rank_in_order(self) -> float | None:
        """Get the rank correlation if near and far are clearly as in the truth."""
        return self.rank if self.rank is not None and self.rank > _IN_ORDER else None

    def in_words(self) -> tuple[str, str]:
        """Return the most important figure, and the others."""
        rank = "" if self.rank is None else f"rank correlation {self.rank:.3f}, "
        off = "" if self.median_px is None else f"; {self.median_px:.3f} px, {self.far_off_share:.1%} over {FAR_OFF_PX}"
        return f"{self.median_rel:.2%} off", f"{rank}{self.close_share:.1%} within {_CLOSE_RATIO}{off}"


def depth_errors(estimate: F32, truth: F32, parallax: float | None = None) -> DepthErrors | None:
    """Measure the errors of depth along the optical axis (Eigen et al. 2014), after scaling by the median.

    One scale is used for all views, because it is the scene's. Pixels where either depth is not above 0 or not finite
    are left out.

    Args:
        estimate: [N, H, W], in any unit; 0 at pixels without a depth.
        truth: The same shape, or [H, W] for one view; 0, NaN or infinite at pixels without a depth.
        parallax: Disparity between neighbouring views at a true depth of 1 (`parallax_of`), px times the unit of the
            truth; None if it is not known.

    Returns:
        The errors; None if no pixel has both depths.

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
    wanted = _known_pixels(truth)
    both = wanted & _known_pixels(estimate)
    if not both.any():
        return None
    pair, known = (estimate[both], truth[both]), float(both.sum() / wanted.sum())
    del wanted, both  # what is as long as the pixels of many exposures goes when it has done its part
    rank = rank_correlation(*pair) if all(np.ptp(one) > 0 for one in pair) else None
    found, true = (one.astype(np.float64) for one in pair)
    del pair
    off_px = None if parallax is None or not np.ptp(true) else parallax * inverse_depth_errors(found, true)
    of_px = (None, None) if off_px is None else (float(np.median(off_px)), float(np.mean(off_px > FAR_OFF_PX)))
    del off_px
    scale = float(np.median(true / found))
    found *= scale
    close = float(np.mean((found < _CLOSE_RATIO * true) & (true < _CLOSE_RATIO * found)))
    found -= true
    rms = rms_of(found)
    relative = np.divide(np.abs(found, out=found), true, out=found)
    return DepthErrors(scale, float(np.mean(relative)), float(np.median(relative)), rms, close, known, rank, *of_px)


def inverse_depth_errors(found: F64, true: F64) -> F64:
    """Return |a / found + b − 1 / true| for the affine fit with a ≥ 0 that minimises their sum, for depths [P], [P].

    With a below 0, depth that has near and far exchanged would have no error.

    A small rotation of the cameras can be exchanged for a part of their translation, which adds a constant to inverse
    depth. With a scale alone, that would count as an error of depth; the errors of the path already include it.
    """
    # In units of its median, so that both are of one size whatever the unit of the estimate is; of many exposures
    # there are tens of millions, so that few arrays of their length are held.
    x, y = np.median(found) / found, 1 / true
    level = max(_LEVEL_SHARE * float(np.ptp(y)), np.finfo(np.float64).tiny)
    x0, y0 = x[0], y[0]
    x -= x0
    y -= y0
    errors = np.ones_like(y)
    for step in range(_ROUNDS):
        weights = np.divide(1, np.maximum(errors, level), out=errors) if step else errors
        total, across, along = weights.sum(), weights @ x, weights @ y
        weights *= x
        square, product = weights @ x, weights @ y
        spread = square - across**2 / total
        slope = (product - across * along / total) / spread if spread > _CONSTANT * square else 0.0
        np.multiply(x, slope, out=errors)
        errors += (along - slope * across) / total
        errors -= y
        np.abs(errors, out=errors)
    return errors if slope >= 0 else np.abs(y - np.median(y))


def parallax_of(world_to_camera: F64, intrinsics: F64) -> float | None:
    """Return the disparity between neighbouring views at a depth of 1: focal length times mean step; None at rest.

    Args:
        world_to_camera: Poses in their order, [N, 4, 4].
        intrinsics: [3, 3], px.
    """
    steps = np.linalg.norm(np.diff(camera_centres(world_to_camera), axis=0), axis=1)
    parallax = float(intrinsics[0, 0] * steps.mean()) if len(steps) else 0.0
    return parallax if parallax > 0 else None


def _known_pixels(depth: F32) -> Bool:
    return np.isfinite(depth) & (depth > 0)
