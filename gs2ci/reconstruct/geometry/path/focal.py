"""The focal length if no file gives it: a search over one number, by the robust cost of the bundle adjustment.

Here: the search and the gate that rejects an uncertain result. Not here: the adjustment (`motion`).
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from gs2ci.core.arrays import F64, Size
from gs2ci.core.cameras import pinhole
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.reconstruct.geometry.path.motion import MotionSettings, adjust_both_ways
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks

# Points of the interpolated probability: 0.0002 apart in the logarithm.
_FINE = 12_001
# Tolerance of the logarithm, far smaller than the uncertainty of a focal length from tracks.
_SETTLED = 1e-3


@dataclass(frozen=True)
class FocalSettings:
    """Where to search and which estimate to accept.

    Args:
        narrowest_deg: Least horizontal field of view.
        widest_deg: Largest horizontal field of view.
        default_deg: Horizontal field of view in the mean of the prior, and if tracks do not determine it.
        prior_spread: Prior standard deviation of the logarithm of the focal length: 0.4 puts two cameras of three
            between 42° and 81°.
        most_spread: Largest posterior standard deviation at which the estimate is accepted.
        independent: Share of the residuals that count as independent. The windows of neighbouring tracks overlap:
            21 px wide, 5 px apart or more.
        grid: Focal lengths tried before refinement, equally spaced in their logarithm.
        refinements: At most so many focal lengths are tried between the best of the grid and its neighbours.
        tracks: At most so many tracks are used.
    """

    narrowest_deg: float = 15.0
    widest_deg: float = 110.0
    default_deg: float = 60.0
    prior_spread: float = 0.4
    most_spread: float = 0.3
    independent: float = 0.05
    grid: int = 13
    refinements: int = 6
    tracks: int = 400


@dataclass(frozen=True)
class Focal:
    """A camera matrix, [3, 3], its source ("file", "estimated" or "default"), and the findings about it."""

    intrinsics: F64
    source: str
    notes: Findings = ()


def focal_from_view_angle(angle_deg: float, width: int) -> float:
    """Get the focal length in px that sees a horizontal angle over `width` px."""
    return 0.5 * width / float(np.tan(np.radians(angle_deg) / 2))


def default_focal(size: Size, why: str, settings: FocalSettings) -> Focal:
    """Return the default field of view and the reason for it."""
    note = finding(Code.FOCAL_ASSUMED, why=why, view_angle_deg=settings.default_deg)
    focal_px = focal_from_view_angle(settings.default_deg, size[1])
    return Focal(pinhole(focal_px, size), "default", (note,))


def estimate_focal(tracks: Tracks, size: Size, settings: FocalSettings, motion: MotionSettings) -> Focal:
    """Find the focal length at which the tracks fit a rigid scene best.

    Args:
        tracks: Enough points for a motion.
        size: Height and width in px.
        settings: Where to search and which estimate to accept.
        motion: How to adjust.

    Returns:
        The most probable value, from the robust reprojection cost and the prior on usual lenses; or the default, if
        that lies at the end of the range or is uncertain (a flat scene, or too little motion).
    """
    sample = _evenly(tracks, settings.tracks)
    sightings = int(sample.seen.sum()) - len(sample)
    freedom = max(2 * sightings - 6 * (sample.positions.shape[1] - 1) - len(sample), 1)
    low, high = (np.log(focal_from_view_angle(a, size[1])) for a in (settings.widest_deg, settings.narrowest_deg))
    middle = np.log(focal_from_view_angle(settings.default_deg, size[1]))
    grid = np.linspace(low, high, settings.grid)

    def cost(log_focal: float) -> float:
        return adjust_both_ways(sample, pinhole(float(np.exp(log_focal)), size), motion).cost

    costs = np.array([cost(value) for value in grid])
    # With unknown noise variance and ν degrees of freedom, the negative log likelihood is ν/2 times the relative excess
    # of the cost.
    weight = settings.independent * freedom / 2 / max(float(costs.min()), np.finfo(np.float32).tiny)

    def surprise(log_focal: float, known_cost: float) -> float:
        return float(weight * known_cost + 0.5 * ((log_focal - middle) / settings.prior_spread) ** 2)

    surprises = np.array([surprise(value, known) for value, known in zip(grid, costs, strict=True)])
    best = int(surprises.argmin())
    if best in (0, settings.grid - 1):
        return default_focal(size, "the best fit lies at the end of the plausible range", settings)
    spread = _spread(grid, surprises)
    if spread > settings.most_spread:
        return default_focal(size, "the tracks fit almost equally well with any", settings)
    finest = minimize_scalar(
        lambda value: surprise(value, cost(value)),
        bounds=(grid[best - 1], grid[best + 1]),
        method="bounded",
        options={"maxiter": settings.refinements, "xatol": _SETTLED},
    )
    focal_px = float(np.exp(finest.x))
    angle_deg = float(np.degrees(2 * np.arctan(0.5 * size[1] / focal_px)))
    note = finding(Code.FOCAL_ESTIMATED, focal_px=focal_px, spread=spread, view_angle_deg=angle_deg)
    return Focal(pinhole(focal_px, size), "estimated", (note,))


def _spread(values: F64, surprises: F64) -> float:
    """Get the standard deviation of a value whose probability is exp(−surprise).

    Near its least a surprise is a parabola, which may be far narrower than the distance between the values: straight
    lines between them would give a width that depends on where among the values the least lies.
    """
    fine = np.linspace(values[0], values[-1], _FINE)
    between = CubicSpline(values, surprises)(fine)
    likelihood = np.exp(between.min() - between)
    likelihood /= likelihood.sum()
    return float(np.sqrt(likelihood @ (fine - likelihood @ fine) ** 2))


def _evenly(tracks: Tracks, most: int) -> Tracks:
    """Take at most so many tracks, evenly over the list, which is ordered by corner strength."""
    chosen = np.zeros(len(tracks), np.bool_)
    chosen[np.linspace(0, len(tracks) - 1, min(most, len(tracks))).astype(int)] = True
    return tracks.keep(chosen)
