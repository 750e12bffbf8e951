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
# Least absolute deviations by iteratively reweighted least squares: number of iterations, and the share of the spread
# below which errors are weighted equally.
_ROUNDS: Final = 50
_LEVEL_SHARE: Final = 1e-3


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
    true, found = truth[both].astype(np.float64), estimate[both].astype(np.float64)
    scale = float(np.median(true / found))
    error = scale * found - true
    ratio = np.maximum(scale * found / true, true / (scale * found))
    varied = np.ptp(true) > 0 and np.ptp(found) > 0
    off_px = None if parallax is None or not np.ptp(true) else parallax * inverse_depth_errors(found, true)
    return DepthErrors(
        scale=scale,
        abs_rel=float(np.mean(np.abs(error) / true)),
        median_rel=float(np.median(np.abs(error) / true)),
        rms=rms_of(error),
        close_share=float(np.mean(ratio < _CLOSE_RATIO)),
        known_share=float(both.sum() / wanted.sum()),
        rank=rank_correlation(found, true) if varied else None,
        median_px=None if off_px is None else float(np.median(off_px)),
        far_off_share=None if off_px is None else float(np.mean(off_px > FAR_OFF_PX)),
    )


def inverse_depth_errors(found: F64, true: F64) -> F64:
    """Return |a / found + b − 1 / true| for the affine fit with a ≥ 0 that minimises their sum, for depths [P], [P].

    With a below 0, depth that has near and far exchanged would have no error.

    A small rotation of the cameras can be exchanged for a part of their translation, which adds a constant to inverse
    depth. With a scale alone, that would count as an error of depth; the errors of the path already include it.
    """
    # In units of its median, so that both columns are of one size whatever the unit of the estimate is.
    design, wanted = np.stack([np.median(found) / found, np.ones_like(found)], axis=1), 1 / true
    level = max(_LEVEL_SHARE * float(np.ptp(wanted)), np.finfo(np.float64).tiny)
    weights = np.ones_like(wanted)
    errors = np.zeros_like(wanted)
    for _ in range(_ROUNDS):
        root = np.sqrt(weights)
        fit, *_ = np.linalg.lstsq(design * root[:, None], wanted * root, rcond=None)
        errors = np.abs(design @ fit - wanted)
        weights = 1 / np.maximum(errors, level)
    return errors if fit[0] >= 0 else np.abs(wanted - np.median(wanted))


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
