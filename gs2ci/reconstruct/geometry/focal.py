"""The focal length where no file tells it: a search over one number, by the bundle adjustment's own robust cost.

Here: the search and the gate that refuses what it cannot tell. Not here: the adjustment (`motion`). Only
`gs2ci.reconstruct.geometry` imports this file.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gs2ci.reconstruct.geometry.motion import MotionSettings, adjust
from gs2ci.reconstruct.geometry.tracks import Tracks

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class FocalSettings:
    """Where to search and what to believe.

    Args:
        narrowest_deg: Least horizontal field of view.
        widest_deg: Largest horizontal field of view.
        default_deg: Horizontal field of view taken where the search cannot tell.
        grid: Focal lengths tried before refinement, equally spaced in their logarithm.
        refinements: Golden-section steps; each narrows the bracket to 0.62 of its width.
        tracks: At most so many tracks take part.
        ratio: The cost is compared at the focal length times and divided by this.
        least_rise: By how much, relative, the cost must rise there on both sides.
    """

    narrowest_deg: float = 15.0
    widest_deg: float = 110.0
    default_deg: float = 60.0
    grid: int = 13
    refinements: int = 7
    tracks: int = 400
    ratio: float = 1.5
    least_rise: float = 0.04


@dataclass(frozen=True)
class Focal:
    """A camera matrix, where its focal length came from, and the sentence that says so."""

    intrinsics: F64
    source: Literal["estimated", "default"]
    note: str


def pinhole(focal_px: float, size: tuple[int, int]) -> F64:
    """Build a camera matrix, [3, 3], with square pixels and the principal point in the middle of the image."""
    height, width = size
    return np.array([[focal_px, 0, width / 2], [0, focal_px, height / 2], [0, 0, 1.0]])


def focal_from_view_angle(angle_deg: float, width: int) -> float:
    """Get the focal length in px that sees a horizontal angle over `width` px."""
    return 0.5 * width / float(np.tan(np.radians(angle_deg) / 2))


def default_focal(size: tuple[int, int], why: str, settings: FocalSettings) -> Focal:
    """Take the default field of view and say why."""
    note = (
        f"The focal length is not known and {why}; a horizontal field of view of {settings.default_deg:.0f}° is "
        "assumed. Depths are then true only up to a stretch; give the camera matrix if you know it."
    )
    focal_px = focal_from_view_angle(settings.default_deg, size[1])
    return Focal(pinhole(focal_px, size), "default", note)


def estimate_focal(tracks: Tracks, size: tuple[int, int], settings: FocalSettings, motion: MotionSettings) -> Focal:
    """Find the focal length at which the tracks fit a rigid scene best.

    Args:
        tracks: Enough points for a motion.
        size: Height and width in px.
        settings: Where to search and what to believe.
        motion: How to adjust.

    Returns:
        The estimate; or the default, where the best value lies at the end of the range, or the cost hardly depends
        on it (a flat scene, or too little motion).
    """
    sample = _evenly(tracks, settings.tracks)

    def cost(log_focal: float) -> float:
        return adjust(sample, pinhole(float(np.exp(log_focal)), size), motion).cost

    low, high = (np.log(focal_from_view_angle(a, size[1])) for a in (settings.widest_deg, settings.narrowest_deg))
    grid = np.linspace(low, high, settings.grid)
    costs = np.array([cost(value) for value in grid])
    best = int(costs.argmin())
    if best in (0, settings.grid - 1):
        return default_focal(size, "the best fit lies at the end of the plausible range", settings)
    log_focal, least = _golden_section(cost, grid[best - 1], grid[best + 1], settings.refinements)
    sides = np.interp((log_focal - np.log(settings.ratio), log_focal + np.log(settings.ratio)), grid, costs)
    if sides.min() < (1 + settings.least_rise) * least:
        return default_focal(size, "the tracks fit almost equally well with any", settings)
    focal_px = float(np.exp(log_focal))
    angle = np.degrees(2 * np.arctan(0.5 * size[1] / focal_px))
    note = f"The focal length was estimated from the tracks: {focal_px:.0f} px, {angle:.0f}° across."
    return Focal(pinhole(focal_px, size), "estimated", note)


def _evenly(tracks: Tracks, most: int) -> Tracks:
    """Take at most so many tracks, evenly over the list, which is ordered by corner strength."""
    chosen = np.zeros(len(tracks), np.bool_)
    chosen[np.linspace(0, len(tracks) - 1, min(most, len(tracks))).astype(int)] = True
    return tracks.keep(chosen)


def _golden_section(cost, low: float, high: float, steps: int) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    """Narrow a bracket around a minimum; returns its place and the cost there."""
    shrink = (np.sqrt(5) - 1) / 2
    a, b = high - shrink * (high - low), low + shrink * (high - low)
    cost_a, cost_b = cost(a), cost(b)
    for _ in range(steps):
        if cost_a < cost_b:
            high, b, cost_b = b, a, cost_a
            a = high - shrink * (high - low)
            cost_a = cost(a)
        else:
            low, a, cost_a = a, b, cost_b
            b = low + shrink * (high - low)
            cost_b = cost(b)
    return (a, cost_a) if cost_a < cost_b else (b, cost_b)
