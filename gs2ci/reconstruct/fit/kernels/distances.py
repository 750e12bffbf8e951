"""How far a Gaussian's distance may change in one step of a fit, and how far away it may be.

Here: the two bounds, which every step along lines of sight obeys: that of single Gaussians, of the depth field and of
the exchange of turning for travel. Not here: the steps.
"""

from typing import Final

from gs2ci.core.kernels import helper

MOST_GROWTH: Final = 0.25
"""The largest relative change of a distance in one step of a fit, whatever makes the step: far away, where inverse
depth is nearly 0, the first order no longer holds, and a step of constant length would pass through infinity."""

FARTHEST: Final = 1e12
"""No step moves a Gaussian farther away than this, in scene units, in which depths are about 1; its square is far
inside float32. Some are drawn beyond infinity and grow by `MOST_GROWTH` in each step: without a bound their positions
left float32 after 391 iterations, and the squares on which the exchange of turning for travel depends after 195. Nobody
sees them by then, since their sizes are cut from 6.6e7 scene units on (`LOG_SCALE_MAX` of the renderer)."""


@helper()
def most_growth(distance: float) -> float:
    """Return the largest relative growth of a distance (scene units, positive) in one step."""
    return min(MOST_GROWTH, max(FARTHEST / distance - 1, 0.0))


@helper()
def bounded(growth: float, distance: float) -> float:
    """Return a relative growth of a distance (scene units, positive), cut to what one step may do."""
    allowed: float = min(max(growth, -MOST_GROWTH), most_growth(distance))
    return allowed
