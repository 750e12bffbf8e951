"""The short fits that tell near from far by the residual of a geometry after a fixed number of iterations.

Here: these fits and their residuals. Not here: what follows from them (`order`).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import NumericsError
from gs2ci.core.progress import Silent
from gs2ci.reconstruct.attempts.order import shortened
from gs2ci.reconstruct.fit.coarse_settings import CoarseSettings
from gs2ci.reconstruct.fit.ensemble import FitOne, members
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.gaussians import Gaussians


@dataclass(frozen=True)
class OrderFits:
    """Fits to one measurement that tell orders of depth apart.

    Args:
        holdout: The measurement, and the pixels that fits do not see.
        settings: Of the reconstruction.
        begin: Returns the geometry at the start of a fit, and its first Gaussians.
        fit_one: Returns the function that makes one fit of a geometry by given settings.
    """

    holdout: Holdout
    settings: Settings
    begin: Callable[[Geometry], tuple[Geometry, Gaussians]]
    fit_one: Callable[[Geometry, CoarseSettings], FitOne]
    _begun: dict[int, tuple[Geometry, tuple[Geometry, Gaussians]]] = field(default_factory=dict)

    def brief(self, geometry: Geometry, number: int) -> float:
        """Fit a geometry briefly, with a seed, and return the mean square of its residual.

        Infinite if the fit diverges. The same object must be given each time for the same geometry.
        """
        # The measurement alone judges: surfaces estimated from the views of either order would confirm that order. And
        # it judges the depths as they are: with steps that move them fast, a wrong order soon leaves hardly more.
        short = shortened(self.settings.fit)
        # The poses of both orders are free: a reversal is only near its minimum.
        steps, poses = replace(short.steps, in_view=None), replace(short.poses, given_weight=0.0)
        settings = replace(short, surfaces=None, relief=None, steps=steps, poses=poses)
        at, start = self._beginning(geometry)
        member = members(start, self.settings.density_rules[:1], number + 1, self.settings.seed)[number]
        try:
            return mean_square(self.holdout, self.fit_one(at, settings)(member, Silent(), None).views)
        except NumericsError:
            return math.inf

    def _beginning(self, geometry: Geometry) -> tuple[Geometry, Gaussians]:
        if id(geometry) not in self._begun:
            # The geometry is stored too: while it lives, no other object gets its id.
            self._begun[id(geometry)] = geometry, self.begin(geometry)
        return self._begun[id(geometry)][1]


def mean_square(holdout: Holdout, views: F32) -> float:
    """Return the mean square of the residual that views, [N, H, W, C], leave at lit pixels that are not saturated."""
    residual = (holdout.coded(views) - holdout.shot.measurement)[holdout.shot.usable].astype(np.float64)
    return float(np.mean(residual**2)) if residual.size else 0.0
