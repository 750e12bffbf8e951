"""The coarse stage as the paper runs it (section IV-A): preset `paper`.

Here: its numbers. Not here: what they mean (each stage's own file). Presets and `gs2ci.bench` import this file.
"""

from dataclasses import replace
from typing import Final

from gs2ci.reconstruct.brightness import BrightnessSettings
from gs2ci.reconstruct.fit.coarse import CoarseSettings
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.losses import LossWeights
from gs2ci.reconstruct.fit.optimiser import StepSizes
from gs2ci.reconstruct.fit.poses import PoseSettings
from gs2ci.reconstruct.fit.stopping import HoldOut
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.settings import RasterSettings

_ITERATIONS: Final = 20_000
_MOST_PER_PIXEL: Final = 4.0
"""The paper bounds the population by what it is at iteration 7,000 and by nothing before. On a machine whose memory
others share something has to: it reports that a run without its bound ends for want of memory."""


def paper_settings() -> Settings:
    """Return the settings of the paper: its schedule, no held-out pixels, and the last state instead of the best.

    Lengths are in units of the camera path's diameter, where the authors' trainer scales the path into a cube of
    side two: the same within a factor that depends on the path's shape.
    """
    fit = CoarseSettings(
        iterations=_ITERATIONS,
        densify_every=100,
        densify_from=500 / _ITERATIONS,
        densify_until=15_000 / _ITERATIONS,
        gaussians_per_pixel=_MOST_PER_PIXEL,
        cap_from=7_000 / _ITERATIONS,
        loss=LossWeights(similarity=0.1, opacity=0.01),
        steps=StepSizes.of_the_literature(),
        poses=PoseSettings(every=25, rate=1e-2, final_rate=2e-5),
        hold_out=HoldOut(share=0.0, look_every=1000, patience=_ITERATIONS, growth_patience=_ITERATIONS),
        density=Osgr(),
    )
    return replace(
        Settings(),
        fit=fit,
        fits=1,
        second_density=None,
        brightness=BrightnessSettings(rounds=0),
        raster=RasterSettings(),
    )
