"""The settings of the coarse stage: its schedule, and the settings of its parts.

Here: `CoarseSettings` and its check. Not here: the stage (`stage.py`), presets of it (`gs2ci.reconstruct.presets`).
"""

from dataclasses import dataclass, field
from typing import Annotated, Final, Self

from pydantic import Field, PositiveInt

from gs2ci.core.bounds import Bounded
from gs2ci.core.errors import InputError
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut
from gs2ci.reconstruct.fit.density.base import DensityRule
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.losses.objective import LossWeights
from gs2ci.reconstruct.fit.optimiser.gaussians import StepSizes
from gs2ci.reconstruct.fit.optimiser.poses import PoseSettings
from gs2ci.reconstruct.fit.scene.colours import ColourSettings
from gs2ci.reconstruct.fit.scene.motion import ObjectMotionSettings
from gs2ci.reconstruct.fit.surfaces.surfaces import SurfaceSettings

STANDARD_ITERATIONS: Final = 280
"""Of the default schedule; more Gaussians make up for fewer iterations (docs/decisions/schedule.md)."""


@dataclass(frozen=True)
class CoarseSettings(Bounded):
    """The schedule of the coarse stage.

    Args:
        iterations: At most this many.
        densify_every: Iterations between applications of the density rule.
        densify_from: Share of the schedule done before the density rule is first applied.
        densify_until: Share of the schedule after which it is no longer applied.
        gaussians_per_pixel: Largest number of Gaussians (the population), as a share of the pixels of one view; None:
            unbounded.
        most_gaussians: Population at which the fit ends with an error, before memory runs out; None: no such guard.
        cap_from: Share of the schedule from which on the population may no longer grow; None: never.
        mask_moments_from: Share of the schedule from which on masks have their moments. Before, each has one: the
            scene is coarser then than the blur within a mask, and an iteration costs as much as it has moments.
        surfaces: How light is drawn to surfaces that the views show; None: only the measurement places it.
        comparable_gradients: Whether the gradients that density rules receive are in a unit that depends neither on
            the masks' share of open pixels nor on the size of a picture, so that one threshold holds for all
            (`density/gathering.py`).
        motion: How Gaussians that start with a motion may move.
        colours: How far colours may change with the direction of sight.
    """

    iterations: PositiveInt = STANDARD_ITERATIONS
    densify_every: PositiveInt = STANDARD_ITERATIONS // 8
    densify_from: float = 0.025
    densify_until: float = 0.75
    gaussians_per_pixel: float | None = 0.4
    most_gaussians: int | None = None
    cap_from: float | None = None
    mask_moments_from: Annotated[float, Field(ge=0, le=1)] = 0.5
    surfaces: SurfaceSettings | None = field(default_factory=SurfaceSettings)
    comparable_gradients: bool = True
    loss: LossWeights = field(default_factory=LossWeights)
    steps: StepSizes = field(default_factory=lambda: StepSizes.of_schedule(STANDARD_ITERATIONS))
    poses: PoseSettings = field(default_factory=PoseSettings)
    hold_out: HoldOut = field(default_factory=lambda: HoldOut().looking(STANDARD_ITERATIONS // 8))
    density: DensityRule = field(default_factory=Osgr.sparing)
    motion: ObjectMotionSettings = field(default_factory=ObjectMotionSettings)
    colours: ColourSettings = field(default_factory=ColourSettings)

    def check(self) -> Self:
        """Return self if the numbers make sense.

        Raises:
            InputError: One is out of its bounds, or there is no bound on the population at all.
        """
        if self.gaussians_per_pixel is None and self.most_gaussians is None:
            raise InputError(
                "a fit without any bound on its population",
                allowed="gaussians_per_pixel, which limits it, or most_gaussians, which ends the fit",
            )
        return super().check()
