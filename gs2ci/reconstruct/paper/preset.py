"""The settings of the paper: GS2CI, sections III and IV-A and the supplement, constant by constant.

Here: the paper's values wherever it states them; otherwise the defaults of its trainer (nerfstudio's splatfacto on
gsplat). docs/paper-preset.md lists every constant with its section, and every deviation with its reason;
`tests/reconstruct/paper/test_preset.py` checks this file against that page. Not here: what the settings mean (each
stage's own file), the other presets (`named`).
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Final

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut
from gs2ci.reconstruct.fit.density.base import DensityRule
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.losses.objective import LossWeights
from gs2ci.reconstruct.fit.optimiser.gaussians import StepSizes
from gs2ci.reconstruct.fit.optimiser.poses import PoseSettings
from gs2ci.reconstruct.fit.scene.colours import ColourSettings
from gs2ci.reconstruct.fit.scene.mask_moments import MaskMomentSettings
from gs2ci.reconstruct.fit.withheld import Withheld
from gs2ci.reconstruct.measurement.brightness import BrightnessSettings
from gs2ci.reconstruct.paper.fine import FineSettings
from gs2ci.reconstruct.registration.register import RegistrationSettings
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.settings import RasterSettings

# The components of the method, each of which can be switched off by name (paper, Table VII).

_Without = Callable[[Settings], Settings]


def _withheld(what: str) -> _Without:
    return lambda settings: replace(settings, withheld=replace(settings.withheld or Withheld(), **{what: True}))


def _without_opacity_split(settings: Settings) -> Settings:
    first, *second = (_unsplit(rule) for rule in settings.density_rules)
    return replace(settings, fit=replace(settings.fit, density=first), second_density=second[0] if second else None)


def _unsplit(density: DensityRule) -> DensityRule:
    if not isinstance(density, Osgr) or not density.opacity_splits:
        raise InputError(
            f"density rule {density.name!r} without its opacity splits", allowed="osgr, the rule that has them"
        )
    return replace(density, opacity_splits=False)


def _without_count_cap(settings: Settings) -> Settings:
    # The paper's own runs without the cap ran out of memory; here the memory guard ends them with an error.
    most = settings.fit.most_gaussians or MOST_GAUSSIANS
    return replace(settings, fit=replace(settings.fit, cap_from=None, gaussians_per_pixel=None, most_gaussians=most))


def _of_fit(part: str, field: str, off: float) -> _Without:
    """Set a field of a part of the fit's settings."""
    return lambda settings: replace(
        settings, fit=replace(settings.fit, **{part: replace(getattr(settings.fit, part), **{field: off})})
    )


COMPONENTS: Final[dict[str, _Without]] = {
    "points": _withheld("points"),
    "poses": _withheld("poses"),
    "opacity-split": _without_opacity_split,
    "opacity-regulation": _of_fit("loss", "opacity", 0.0),
    "count-cap": _without_count_cap,
    "pose-refinement": _of_fit("poses", "refine", False),
}
"""By component, in the order of the paper's table: the function that returns settings without it."""


def without(settings: Settings, names: Iterable[str]) -> Settings:
    """Return settings with the named components switched off.

    Raises:
        InputError: There is no component of that name, or the settings do not have it.
    """
    for name in names:
        if name not in COMPONENTS:
            raise InputError(f"no component {name!r}", allowed=", ".join(COMPONENTS))
        settings = COMPONENTS[name](settings)
    return settings


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
