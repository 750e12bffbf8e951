"""The fits that tell near from far: brief ones of either order, and finished ones that are turned inside out.

    brief:     first Gaussians ─► 60 iterations ─► what is left of all readings
    finish:    first Gaussians ─► a whole fit ─┬─► as it is       ─► 100 iterations ─┐
                                               └─► turned inside out ─► 100 iterations ─┴─► what the second leaves more

A finished scene knows what hides what, and loses that when it is turned inside out if it was right; if it was wrong, it
loses little. Here: these fits, and what they leave. Not here: what follows (`order`), the reversal (`fit/mirror.py`).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.errors import NumericsError
from gs2ci.core.progress import Silent
from gs2ci.reconstruct.attempts.order import FinishedScene, shortened
from gs2ci.reconstruct.fit.coarse import CoarseFit, CoarseSettings
from gs2ci.reconstruct.fit.ensemble import FitOne, Member, members
from gs2ci.reconstruct.fit.mirror import inside_out
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.measurement.jury import Jury
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.gaussians import Gaussians

# A scene turned inside out has what it can regain by then, and long before: it begins with all colours.
_FURTHER: Final = 100
# A whole fit is no longer: with 150 iterations, without surfaces, the right order of one of four scenes was not told.
_WHOLE: Final = 250


@dataclass(frozen=True)
class OrderFits:
    """Fits to one measurement that tell orders of depth apart.

    Args:
        jury: The measurement, and the pixels that fits do not see.
        settings: Of the reconstruction.
        begin: Returns the geometry as it is fitted, and the first Gaussians of it.
        fit_one: Says how a geometry's fits go, by these settings.
        depths: Renders depths, [V, H, W], of a scene from poses, [V, 4, 4]; 0 where nothing is.
    """

    jury: Jury
    settings: Settings
    begin: Callable[[Geometry], tuple[Geometry, Gaussians]]
    fit_one: Callable[[Geometry, CoarseSettings], FitOne]
    depths: Callable[[Geometry, Gaussians, F64], F32]
    _begun: dict[int, tuple[Geometry, tuple[Geometry, Gaussians]]] = field(default_factory=dict)

    def brief(self, geometry: Geometry, number: int) -> float:
        """Fit a geometry briefly, with a seed, and return the mean square that it leaves of the measurement.

        Infinite where its numbers run away. The same object must be given each time for the same geometry.
        """
        # By the measurement alone: views of either order show surfaces that bear it out.
        settings = replace(shortened(self.settings.fit), surfaces=None, relief=None)
        at, start = self._beginning(geometry)
        member = members(start, self.settings.density_rules[:1], number + 1, self.settings.seed)[number]
        fit = self._fit(at, settings, member)
        return math.inf if fit is None else mean_square(self.jury, fit.views)

    def finish(self, geometry: Geometry) -> FinishedScene | None:
        """Fit a geometry to the end, turn it inside out, and go on with both; None where numbers run away.

        Logarithms are means of those of the pixels that fits see and of those they do not: the former are many, but
        show the noise that was followed, too.
        """
        fit = self.settings.fit
        whole = min(fit.iterations, _WHOLE)
        at, start = self._beginning(geometry)
        rule = self.settings.density_rules[0]
        finished = self._fit(
            at,
            replace(fit, iterations=whole, densify_every=max(1, whole // 8)),
            Member(start, rule, self.settings.seed),
        )
        if finished is None:
            return None
        further = replace(fit, iterations=_FURTHER, densify_from=1.0, surfaces=None, relief=None)
        own = finished.world_to_camera[at.reference : at.reference + 1]
        seen = self.depths(at, finished.scene, own)
        seen = seen[np.isfinite(seen) & (seen > 0)]
        if not seen.size:
            return None
        turned, path = inside_out(finished.scene, finished.world_to_camera, at.reference, 2 / float(np.median(seen)))
        left = []
        for scene, poses in ((finished.scene.detach(), finished.world_to_camera), (turned, path)):
            went_on = self._fit(replace(at, world_to_camera=poses), further, Member(scene, rule, self.settings.seed))
            if went_on is None:
                return None
            left.append(self._log_left(went_on.views))
        return FinishedScene(left[0], left[1] - left[0]) if np.isfinite(left).all() else None

    def _log_left(self, views: F32) -> float:
        sides = [~self.jury.heldout, *([self.jury.heldout] if self.jury.heldout.any() else [])]
        found = [mean_square(self.jury, views, side) for side in sides]
        return sum(math.log(one) if one > 0 else -math.inf for one in found) / len(found)

    def _beginning(self, geometry: Geometry) -> tuple[Geometry, Gaussians]:
        if id(geometry) not in self._begun:
            # The geometry is kept beside, so that no other one gets its number.
            self._begun[id(geometry)] = geometry, self.begin(geometry)
        return self._begun[id(geometry)][1]

    def _fit(self, geometry: Geometry, settings: CoarseSettings, member: Member) -> CoarseFit | None:
        try:
            return self.fit_one(geometry, settings)(member, Silent(), None)
        except NumericsError:
            return None


def mean_square(jury: Jury, views: F32, among: Bool | None = None) -> float:
    """Return the mean square that views, [N, H, W, C], leave of the readings that can be trusted.

    Args:
        jury: The measurement.
        views: What is judged.
        among: Which readings are asked, [H, W] bool; None for all.
    """
    asked = jury.shot.lit if among is None else jury.shot.lit & among
    if jury.shot.saturated is not None:
        asked = asked & ~jury.shot.saturated
    residual = (jury.coded(views) - jury.shot.measurement)[asked].astype(np.float64)
    return float(np.mean(residual**2)) if residual.size else 0.0
