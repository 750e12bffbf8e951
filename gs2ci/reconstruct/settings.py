"""The settings of a whole reconstruction: those of each stage, side by side.

Here: their names, defaults and checks. Not here: what a stage does with its settings (the stage's file), named
settings (`presets`), the order of the stages (`pipeline`).
"""

from dataclasses import dataclass, field, replace
from typing import Annotated, Final

from pydantic import Field, PositiveInt

from gs2ci.core.bounds import Bounded
from gs2ci.reconstruct.choices import MOST_FITS, FirstLookName, LeftOut, MotionMode, PoseSource, ProxyName
from gs2ci.reconstruct.decode.gap_tv import RESIDUAL, GapTvSettings
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.density.base import DensityRule
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.extensions import LastStageSettings
from gs2ci.reconstruct.fit.rules import with_rule
from gs2ci.reconstruct.fit.scene.mask_moments import MaskMomentSettings
from gs2ci.reconstruct.fit.withheld import Withheld
from gs2ci.reconstruct.geometry.initialise import GeometrySettings
from gs2ci.reconstruct.measurement.brightness import BrightnessSettings
from gs2ci.reconstruct.registration.register import RegistrationSettings
from gs2ci.render.settings import RasterSettings

# Lists kept for so many iterations lose nothing compared with the spread over seeds (−0.06 to 0.02 dB) and save a tenth
# of an iteration's time (`python -m tests.benchmarks list_reuse`).
_RELIST_EVERY: Final = 4


@dataclass(frozen=True)
class Settings(Bounded):
    """Settings of every stage.

    Args:
        poses: Where the initial poses and depth come from, by one of the names that `geometry.choose` knows: "auto",
            "tracks", "stage", "file:PATH", ...
        proxy: The views from which geometry is estimated: the decoded ones ("gap-tv"), or the proxies of the paper.
        first_look: The decoder that runs before anything is fitted (`decode.by_name`).
        decode: Of GAP-TV, which every decoder begins with.
        long_decode: Of the decode by similar patches (`decode.patches.decoder`), which may become part of the delivered
            views and gives fits of moving scenes their start; None: only the first look decodes.
        polish: Of the decode by similar patches that starts from the refined views, as one more candidate for the
            delivered ones (`fusion`); None skips it.
        geometry: Of tracks, motion and depth.
        fit: Of the coarse stage.
        fits: How many coarse fits there are at least; the views are their mean (`fit/combining/ensemble.py`). Fits
            along each of two doubtful paths count among them.
        second_density: The density rule of every second of them; None: that of the first.
        fine: Of the stage after the coarse ones, the paper's fine stage; None skips it.
        fine_if_asked: Its settings if a user requests it and `fine` is None; None: its defaults.
        residual: Of the last step, which decodes the residual that the scene leaves; None returns the scene's views
            unchanged and never combines them with the decode.
        stride_px: Distance of the first Gaussians along rows and columns.
        withheld: The part of the geometry that is withheld from the fit, for ablations; None: nothing.
        device: Where to render, as `gs2ci.render.devices.place` takes it: "cpu", "auto", "cuda:1".
        backend: The renderer.
        raster: What the renderer may leave out for speed.
        brightness: Of the estimate of the views' brightness, which corrects wrong weights.
        mask_moments: Of the camera's motion while one mask is displayed.
        look_again: Whether a doubtful or missing first path is sought in the fitted views, and fitted once more
            (`hypotheses.again`), and whether views far apart are matched again (`hypotheses.matches`). Not within a
            budget.
        motion: Whether things in the scene may move: "auto" tries it if motion explains part of the still fits'
            residual, but not within a budget; "on": from the start; "off": never (`hypotheses.moving`).
        registration: Of the step before all others, which estimates from the measurement where its masks lie.
        uncertainty: Whether standard errors of views, depths and poses are estimated; nothing else depends on them.
        left_out: Parts that are left out, to see what they give (`mechanisms`).
        seed: Seed of every random draw.
    """

    poses: PoseSource = "auto"
    proxy: ProxyName = "gap-tv"
    first_look: FirstLookName = "gap-tv"
    decode: GapTvSettings = field(default_factory=GapTvSettings)
    long_decode: PatchSettings | None = field(default_factory=PatchSettings)
    polish: PatchSettings | None = field(default_factory=PatchSettings.polish_sparsely)
    geometry: GeometrySettings = field(default_factory=GeometrySettings)
    fit: CoarseSettings = field(default_factory=CoarseSettings)
    fits: Annotated[int, Field(ge=1, le=MOST_FITS)] = 2
    second_density: DensityRule | None = field(default_factory=Osgr.generous)
    fine: LastStageSettings | None = None
    fine_if_asked: LastStageSettings | None = None
    residual: GapTvSettings | None = RESIDUAL
    stride_px: PositiveInt = 3
    withheld: Withheld | None = None
    device: str = "cpu"
    backend: str = "cpu"
    raster: RasterSettings = field(default_factory=lambda: RasterSettings(relist_every=_RELIST_EVERY))
    brightness: BrightnessSettings = field(default_factory=BrightnessSettings)
    mask_moments: MaskMomentSettings = field(default_factory=MaskMomentSettings)
    look_again: bool = True
    motion: MotionMode = "auto"
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    uncertainty: bool = True
    left_out: tuple[LeftOut, ...] = ()
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 42

    @property
    def may_look_again(self) -> bool:
        """Get whether a second look may be taken: pixels are held out to judge it, and no geometry is withheld."""
        return self.look_again and self.fit.hold_out.share > 0 and self.withheld is None

    @property
    def may_move(self) -> bool:
        """Get whether a moving scene may be tried beside a still one: pixels are held out to judge it."""
        return self.motion == "auto" and self.fit.hold_out.share > 0 and self.withheld is None

    @property
    def density_rules(self) -> tuple[DensityRule, ...]:
        """Get the density rules that the fits use in turn."""
        return (self.fit.density,) if self.second_density is None else (self.fit.density, self.second_density)

    def with_density_rule(self, rule: str | DensityRule) -> "Settings":
        """Return settings in which every fit has one density rule.

        Args:
            rule: Its name, which also sets the rule's objective unless the first fit has this rule already; or a rule
                object of the caller, which keeps the objective of these settings.

        Raises:
            InputError: There is no rule of that name.
        """
        if not isinstance(rule, str):
            return replace(self, fit=replace(self.fit, density=rule), second_density=None)
        fit = with_rule(self.fit, rule)
        return self if fit == self.fit else replace(self, fit=fit, second_density=None)
