"""`gs2ci reconstruct`: from a shot file to a run folder.

Here: the arguments, and the order read → plan → reconstruct → write → tell. Not here: any of the five. Only `gs2ci.cli`
and `gs2ci.commands.demo` import this file.
"""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from gs2ci.commands.display import Display, open_display, print_summary
from gs2ci.core.arrays import F32, F64
from gs2ci.core.clock import command_age_s
from gs2ci.core.durations import parse_duration_s
from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.core.storage import read_shot
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.evaluate.rehearsal import report_seconds
from gs2ci.evaluate.run_folder import check_destination, write_run
from gs2ci.reconstruct import ablation
from gs2ci.reconstruct.budget import Adapt, Plan, plan_within
from gs2ci.reconstruct.costs import probe
from gs2ci.reconstruct.fit.fine import FineSettings
from gs2ci.reconstruct.fit.looks import Score
from gs2ci.reconstruct.fit.rules import RuleName
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.presets import PRESETS, PresetName
from gs2ci.reconstruct.proxies.routing import ProxyName
from gs2ci.reconstruct.settings import PoseSource, Settings
from gs2ci.render.backend import needs_compiling


def run(
    shot: Annotated[Path, tyro.conf.Positional],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("run"),
    *,
    index: int = 0,
    geometry: PoseSource = "auto",
    proxy: ProxyName = "gap-tv",
    preset: PresetName = "standard",
    budget: str | None = None,
    density: RuleName | None = None,
    without: tuple[str, ...] = (),
    iterations: int | None = None,
    fits: int | None = None,
    fine: bool = False,
    prior: str | None = None,
    distance: str | None = None,
    focal_px: float | None = None,
    trust_weights: bool = False,
    seed: int = 42,
    overwrite: bool = False,
) -> Path:
    """Recover views, camera path and scene from one coded measurement.

    Args:
        shot: A shot file, as `gs2ci import` and `gs2ci capture` write them.
        output: The run folder to write.
        index: Which shot of the file.
        geometry: Where the first poses come from: "tracks" finds them in the decoded views, "stage" takes those that
            the stage reported, "file:PATH" those of a COLMAP model's folder or a transforms.json, "vggt" (or
            "vggt:FILE") those that a model of yours predicts; "auto" takes the stage's where there are any and the
            measurement does not speak against them, else the tracks'. The fit refines them in any case.
        proxy: The views that the geometry is found in: decoded by "gap-tv", or "eni" or "amdi", the paper's proxies.
        preset: How far to go: "draft" is a first look, "standard" the default, "fine" takes several times as long and
            ends with the fine stage, "paper" is the schedule of the GS2CI paper, 20,000 iterations without held-out
            pixels.
        budget: Instead of a preset, the time that everything together may take, as in 60s or 5min: the best that
            this machine can do by then.
        density: The rule by which Gaussians are added and removed, with the terms of the objective that belong to it;
            none leaves the settings' own.
        without: Components of the method to do without, for comparisons: points, poses, opacity-split,
            opacity-regulation, count-cap, pose-refinement.
        iterations: At most so many iterations of the fit; it ends earlier when held-out pixels stop improving.
        fits: How many fits run side by side; the views are their mean. More take longer and show more.
        fine: Go on with the fine stage: views from beside the cameras are held to what a prior on images says of them.
            Kept only where held-out pixels agree.
        prior: For the fine stage, which it switches on: "consistent" (detail that several cameras agree on; what
            --fine takes), "nlm" (non-local means), "none", "difix" (added by `gs2ci models add`), or "onnx:FILE".
        distance: For the fine stage, which it switches on: "structure" (1 − SSIM over three scales), "lpips" (added
            by `gs2ci models add`), or "lpips:FILE".
        focal_px: Focal length along the rows to use instead of the file's, in pixels.
        trust_weights: Take each mask's weight as the file states it, whatever the measurement shows of the lamp.
        seed: Of every random draw; the same seed gives the same result.
        overwrite: Replace an earlier run at the same place.

    Returns:
        The run folder.

    Raises:
        Gs2ciError: The file, a value or the destination cannot be used, or the budget does not suffice; the folder
            is then as it was.
    """
    began_s = time.monotonic() - command_age_s()
    wishes = _Wishes(geometry, proxy, density, without, iterations, fits, fine, prior, distance, trust_weights, seed)
    budget_s = _budget_s(budget, preset, wishes)
    check_destination(output, overwrite=overwrite)
    measured = _measured(shot, index, focal_px)
    settings, pace = wishes.on(PRESETS[preset]), None
    with open_display() as display:
        if needs_compiling(settings.backend):
            display.say("The first run on this machine compiles the rasteriser, once: give it half a minute more.")
        if budget_s is not None:
            plan = _plan(budget_s, began_s, measured, wishes.on, display)
            settings, pace = plan.settings, plan.pace
        found = reconstruct(measured, settings, display, _score_against_truth(measured), pace)
        display.stage("report")
        write_run(output, measured, found.result, found.scene, overwrite=overwrite)
    print_summary(output)
    return output


@dataclass(frozen=True)
class _Wishes:
    """What the user wants of any settings, whichever preset they come from."""

    geometry: PoseSource
    proxy: ProxyName
    density: RuleName | None
    without: tuple[str, ...]
    iterations: int | None
    fits: int | None
    fine: bool
    prior: str | None
    distance: str | None
    trust_weights: bool
    seed: int

    @property
    def fine_stage(self) -> bool:
        """Get whether the fine stage is asked for, by its name or by one of its parts."""
        return self.fine or self.prior is not None or self.distance is not None

    def on(self, settings: Settings) -> Settings:
        """Return settings changed as wished."""
        settings = replace(settings, seed=self.seed, poses=self.geometry, proxy=self.proxy)
        if self.trust_weights:
            settings = replace(settings, brightness=replace(settings.brightness, rounds=0))
        if self.density is not None:
            settings = settings.with_density_rule(self.density)
        settings = ablation.without(settings, self.without)
        if self.iterations is not None:
            settings = replace(settings, fit=replace(settings.fit, iterations=self.iterations))
        if self.fits is not None:
            settings = replace(settings, fits=self.fits)
        if self.fine_stage:
            default = FineSettings()
            stage = replace(default, prior=self.prior or default.prior, distance=self.distance or default.distance)
            settings = replace(settings, fine=stage)
        return settings


def _budget_s(budget: str | None, preset: PresetName, wishes: _Wishes) -> float | None:
    """Read the budget, which leaves nothing else to decide."""
    if budget is None:
        return None
    budget_s = parse_duration_s(budget)
    if preset != "standard" or wishes.iterations is not None or wishes.fine_stage:
        raise InputError(
            "a budget decides preset, iterations and stages itself",
            remedy="give either --budget, or --preset, --iterations and --fine",
        )
    return budget_s


def _measured(file: Path, index: int, focal_px: float | None) -> Shot:
    """Read a shot, with the focal length that the user knows better."""
    shot = read_shot(file, index)
    return shot if focal_px is None else replace(shot, intrinsics=_with_focal(focal_px, shot)).check()


def _plan(budget_s: float, began_s: float, shot: Shot, adapt: Adapt, display: Display) -> Plan:
    """Measure this machine on the shot, and plan what the budget buys."""
    display.stage("measuring this machine")
    model = probe(shot, adapt(PRESETS["draft"]).backend)
    report_s = report_seconds(shot)
    plan = plan_within(budget_s, model, report_s=report_s, spent_s=time.monotonic() - began_s, adapt=adapt)
    display.say(plan.sentence)
    return plan


def _with_focal(focal_px: float, shot: Shot) -> F64:
    """Return the shot's camera matrix with another focal length; its principal point and pixel shape stay."""
    height, width = shot.size
    if shot.intrinsics is None:
        return np.array([[focal_px, 0, width / 2], [0, focal_px, height / 2], [0, 0, 1]])
    intrinsics = shot.intrinsics.astype(np.float64)
    intrinsics[1, 1] *= focal_px / intrinsics[0, 0]
    intrinsics[0, 0] = focal_px
    return intrinsics


def _score_against_truth(shot: Shot) -> Score | None:
    """Return the mean PSNR as a function of views, or None where the truth is not known."""
    truth = shot.truth.views
    if truth is None:
        return None

    def score(views: F32) -> float:
        return float(np.mean(psnr_per_view(views, truth)))

    return score
