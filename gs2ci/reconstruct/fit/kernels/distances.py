"""How far a Gaussian's distance may change in one step of a fit, and how far away it may be.

Here: the two bounds, which every step along lines of sight obeys, that of single Gaussians and of the depth field; and
where a camera sees a Gaussian. Not here: the steps.
"""

from typing import Any, Final

from numpy.typing import NDArray

from gs2ci.core.arrays import F64
from gs2ci.core.kernels import helper

MOST_GROWTH: Final = 0.25
"""The largest relative change of a distance in one step of a fit, whatever makes the step: far away, where inverse
depth is nearly 0, the first order no longer holds, and a step of constant length would pass through infinity."""

FARTHEST: Final = 1e12
"""No step moves a Gaussian farther away than this, in scene units, in which depths are about 1; its square is far
inside float32. Some are drawn beyond infinity and grow by `MOST_GROWTH` in each step: without a bound their positions
left float32 after 391 iterations. Nobody sees them by then, since their sizes are cut from 6.6e7 scene units on
(`LOG_SCALE_MAX` of the renderer)."""


@helper()
def most_growth(distance: float) -> float:
    """Return the largest relative growth of a distance (scene units, positive) in one step."""
    return min(MOST_GROWTH, max(FARTHEST / distance - 1, 0.0))


@helper()
def bounded(growth: float, distance: float) -> float:
    """Return a relative growth of a distance (scene units, positive), cut to what one step may do."""
    allowed: float = min(max(growth, -MOST_GROWTH), most_growth(distance))
    return allowed


@helper()
def turned(vectors: NDArray[Any], pose: F64, g: int) -> tuple[float, float, float]:
    """Return a row of vectors, [G, 3], in the axes of a camera, [4, 4]."""
    x, y, z = vectors[g, 0], vectors[g, 1], vectors[g, 2]
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z,
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z,
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z,
    )


@helper()
def seen_from(means: NDArray[Any], pose: F64, g: int) -> tuple[float, float, float]:
    """Return the camera coordinates of a Gaussian's centre; means: [G, 3], pose: [4, 4]."""
    x, y, z = turned(means, pose, g)
    return x + pose[0, 3], y + pose[1, 3], z + pose[2, 3]
