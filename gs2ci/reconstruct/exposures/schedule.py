"""The schedule of a fit to several exposures, from that of a fit to one.

Here: how iterations, looks and density rules stretch. Not here: the schedule itself (`fit/coarse/settings.py`).
"""

import math
from dataclasses import replace
from typing import Final

from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings

# Iterations grow with this power of the number of exposures, of which each iteration sees one.
_GROWTH: Final = 0.5


def shared_schedule(fit: CoarseSettings, exposures: int, growth: float) -> CoarseSettings:
    """Return the schedule of a fit to so many exposures; that of one is unchanged.

    Looks and turns of the density rule stay as many, and lie a whole number of rounds apart, so that each has seen
    every exposure equally often.

    Args:
        fit: The schedule for one.
        exposures: How many.
        growth: How many times as many first Gaussians there are as for one, which the population's bound follows.
    """
    if exposures == 1:
        return fit
    stretch = exposures**_GROWTH
    between, hold_out = _rounds(fit.densify_every * stretch, exposures), fit.hold_out
    return replace(
        fit,
        iterations=_rounds(fit.iterations * stretch, exposures),
        densify_every=between,
        hold_out=replace(
            hold_out,
            look_every=_rounds(hold_out.look_every * stretch, exposures),
            patience=_rounds(hold_out.patience * stretch, exposures),
            growth_patience=_rounds(hold_out.growth_patience * stretch, exposures),
        ),
        gaussians_per_pixel=None if fit.gaussians_per_pixel is None else fit.gaussians_per_pixel * max(1.0, growth),
    )


def _rounds(iterations: float, exposures: int) -> int:
    """Return about so many iterations that are whole rounds, one at least."""
    return exposures * max(1, math.ceil(iterations / exposures - 0.5))
