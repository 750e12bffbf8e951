"""Effects of the arguments of `gs2ci reconstruct` on settings and shot, and the plan for a budget of seconds.

Here: changed settings, a shot with a focal length given by the user, the plan of a budget. Not here: the
settings (`gs2ci.reconstruct`), the order of the work (`reconstruction`).
"""

from dataclasses import dataclass, replace
from typing import Any, get_args

import numpy as np

from gs2ci.api.options import check_choice, check_kind, check_whole
from gs2ci.core.arrays import F32
from gs2ci.core.durations import parse_duration_s
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot, check_rigid
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.choices import (
    FirstLookName,
    LightMode,
    MotionMode,
    PoseSource,
    PresetName,
    ProxyName,
    RegistrationMode,
    RuleName,
    WithinMask,
)
from gs2ci.reconstruct.fit.coarse.looks import Score
from gs2ci.reconstruct.fit.density.base import DensityRule
from gs2ci.reconstruct.paper.fine import FineSettings
from gs2ci.reconstruct.paper.preset import without
from gs2ci.reconstruct.presets.named import preset
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.devices import check_device
from gs2ci.render.harmonics import DEGREE_MAX


@dataclass(frozen=True, kw_only=True)
class Overrides:
    """Changes to the settings of any preset; None keeps the preset's value."""

    geometry: PoseSource | None = None
    proxy: ProxyName | None = None
    first_look: FirstLookName | None = None
    density: RuleName | DensityRule | None = None
    without: tuple[str, ...] = ()
    iterations: int | None = None
    fits: int | None = None
    sh_degree: int | None = None
    fine: bool = False
    prior: str | None = None
    distance: str | None = None
    trust_weights: bool = False
    light: LightMode | None = None
    within_mask: WithinMask | None = None
    registration: RegistrationMode | None = None
    motion: MotionMode | None = None
    device: str | None = None
    seed: int = 42

    def __post_init__(self) -> None:
        """Refuse values of a kind that no option has, before anything is computed.

        Raises:
            InputError: A value is of another kind.
        """
        text, nothing = "a text", type(None)
        remedy = "poses that you know belong into the shot, as telemetry_world_to_camera; then say geometry='stage'"
        check_kind("--geometry", self.geometry, (str, nothing), text, remedy=remedy)
        for option, value in (("--prior", self.prior), ("--distance", self.distance), ("--device", self.device)):
            check_kind(option, value, (str, nothing), text)
        for option, switch in (("--fine", self.fine), ("--trust-weights", self.trust_weights)):
            check_kind(option, switch, bool, "True or False")
        check_kind("--without", self.without, (tuple, list), "a list of components, such as ('points',)")
        check_kind("--density", self.density, (str, DensityRule, nothing), "a rule's name, or a rule of your own")

    @property
    def fine_stage(self) -> bool:
        """Get whether the fine stage is requested, by its name or by one of its parts."""
        return self.fine or self.prior is not None or self.distance is not None

    def on(self, settings: Settings) -> Settings:
        """Return settings with these changes.

        Raises:
            InputError: A name is unknown.
        """
        given: dict[str, Any] = {
            "poses": self.geometry,
            "proxy": self.proxy,
            "motion": self.motion,
            "first_look": self.first_look,
            "fits": self.fits,
            "device": self.device,
        }
        changed = {name: value for name, value in given.items() if value is not None}
        settings = replace(settings, seed=self.seed, **changed)
        if self.trust_weights:
            settings = replace(settings, brightness=replace(settings.brightness, rounds=0))
        if self.light is not None:
            settings = replace(settings, brightness=replace(settings.brightness, light=self.light))
        if self.within_mask is not None:
            settings = replace(settings, mask_moments=replace(settings.mask_moments, within_mask=self.within_mask))
        if self.registration is not None:
            settings = replace(settings, registration=replace(settings.registration, mode=self.registration))
        if self.density is not None:
            settings = settings.with_density_rule(self.density)
        settings = self._on_fit(without(settings, self.without))
        if self.fine_stage:
            stage = settings.fine or settings.fine_if_asked or FineSettings()
            settings = replace(settings, fine=stage.with_models(self.prior, self.distance))
        return settings

    def _on_fit(self, settings: Settings) -> Settings:
        fit = settings.fit
        if self.iterations is not None:
            fit = replace(fit, iterations=self.iterations)
        if self.sh_degree is not None:
            check_whole("--sh-degree", self.sh_degree, 0, DEGREE_MAX)
            fit = replace(fit, colours=replace(fit.colours, degree=self.sh_degree))
        return replace(settings, fit=fit)


def budget_seconds(budget: str | None, preset: PresetName, overrides: Overrides) -> float | None:
    """Read the budget, which decides preset, iterations and stages itself; None if none is given.

    Raises:
        InputError: It is no duration, or preset, iterations or the fine stage are given as well.
    """
    if budget is None:
        return None
    budget_s = parse_duration_s(budget)
    if preset != "standard" or overrides.iterations is not None or overrides.fine_stage:
        raise InputError(
            "a budget decides preset, iterations and stages itself",
            remedy="give either --budget, or --preset, --iterations and --fine",
        )
    return budget_s


def settings_of(name: PresetName, overrides: Overrides) -> Settings:
    """Return a preset's settings with the changes.

    Raises:
        InputError: A name is unknown.
    """
    for option, value, allowed in (
        ("--proxy", overrides.proxy, (None, *get_args(ProxyName))),
        ("--first-look", overrides.first_look, (None, *get_args(FirstLookName))),
        ("--light", overrides.light, (None, *get_args(LightMode))),
        ("--within-mask", overrides.within_mask, (None, *get_args(WithinMask))),
        ("--registration", overrides.registration, (None, *get_args(RegistrationMode))),
    ):
        check_choice(option, value, allowed)
    if overrides.device is not None:
        check_device(overrides.device)
    return overrides.on(preset(name))


def with_focal(focal_px: float | None, shot: Shot) -> Shot:
    """Return a shot with another focal length; its principal point and pixel shape stay.

    Args:
        focal_px: Along the rows; None leaves the shot's.
        shot: With a camera matrix or without.
    """
    if focal_px is None:
        return shot
    height, width = shot.size
    if shot.intrinsics is None:
        intrinsics = np.array([[focal_px, 0, width / 2], [0, focal_px, height / 2], [0, 0, 1]])
    else:
        intrinsics = shot.intrinsics.astype(np.float64)
        intrinsics[1, 1] *= focal_px / intrinsics[0, 0]
        intrinsics[0, 0] = focal_px
    return replace(shot, intrinsics=intrinsics).check()


def score_against_truth(shot: Shot) -> Score | None:
    """Return the mean PSNR as a function of views, or None where the truth is not known.

    Raises:
        InputError: True poses are no rigid motions, by which the path could not be scored at the end.
    """
    if shot.truth.world_to_camera is not None:
        check_rigid("true poses", shot.truth.world_to_camera)
    truth = shot.truth.views
    if truth is None:
        return None

    def score(views: F32) -> float:
        return float(np.mean(psnr_per_view(views, truth)))

    return score
