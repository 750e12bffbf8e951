"""The settings of the paper: GS2CI, sections III and IV-A and the supplement, constant by constant.

Here: the paper's values wherever it states them; otherwise the defaults of its trainer (nerfstudio's splatfacto on
gsplat). docs/paper-preset.md lists every constant with its section, and every deviation with its reason;
`tests/reconstruct/paper/test_preset.py` checks this file against that page. Not here: what the settings mean (each
stage's own file), the other presets (`named`).
"""

from dataclasses import replace
from typing import Final

from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.losses.objective import LossWeights
from gs2ci.reconstruct.fit.optimiser.gaussians import StepSizes
from gs2ci.reconstruct.fit.optimiser.poses import PoseSettings
from gs2ci.reconstruct.fit.scene.colours import ColourSettings
from gs2ci.reconstruct.fit.scene.mask_moments import MaskMomentSettings
from gs2ci.reconstruct.measurement.brightness import BrightnessSettings
from gs2ci.reconstruct.paper.fine import FineSettings
from gs2ci.reconstruct.registration.register import RegistrationSettings
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.settings import RasterSettings

_ITERATIONS: Final = 20_000
MOST_GAUSSIANS: Final = 2_000_000
"""The memory guard. The paper bounds the number of Gaussians by their number at iteration 7,000, without a bound before
that, and reports that runs without a bound exhaust the memory of a graphics card. Here such a run ends with an error.
For two million Gaussians the optimiser needs 450 MB, and a rendering of eight views a few times as much."""


def paper_settings() -> Settings:
    """Return the settings of the paper: its schedule, nothing held out, the last state and the scene's own views."""
    steps = StepSizes.of_the_literature(unit="path cube")
    fit = CoarseSettings(
        iterations=_ITERATIONS,
        densify_every=100,
        densify_from=500 / _ITERATIONS,
        densify_until=15_000 / _ITERATIONS,
        gaussians_per_pixel=None,
        most_gaussians=MOST_GAUSSIANS,
        cap_from=7_000 / _ITERATIONS,
        surfaces=None,
        comparable_gradients=False,
        loss=LossWeights(similarity=0.1, opacity=0.01),
        steps=steps,
        poses=PoseSettings(every=25, rate=1e-2, final_rate=2e-5, unit="path cube", given_weight=0.0),
        hold_out=HoldOut(share=0.0, look_every=1000, patience=_ITERATIONS, growth_patience=_ITERATIONS),
        density=Osgr.of_the_paper(),
        # nerfstudio's splatfacto: sh_degree 3, sh_degree_interval 1,000.
        colours=ColourSettings(degree=3, every=1_000 / _ITERATIONS),
    )
    return replace(
        Settings(),
        poses="vggt-or-tracks",
        proxy="routed",
        look_again=False,
        fit=fit,
        fits=1,
        second_density=None,
        fine_if_asked=FineSettings.of_the_paper(steps),
        residual=None,
        brightness=BrightnessSettings(rounds=0),
        registration=RegistrationSettings(mode="off"),
        raster=RasterSettings(),
        # One pose for each mask (equation 1).
        mask_moments=MaskMomentSettings("still"),
    )
