"""From a shot to a run: settings, budget, reconstruct.

Here: the order of these, with the progress shown. Not here: what arguments change of settings and shot
(`overrides`), the reconstruction (`gs2ci.reconstruct.pipeline`).
"""

import time
from pathlib import Path
from typing import TYPE_CHECKING

from gs2ci.api.display import interrupted_within, shown
from gs2ci.api.options import check_number, check_seed, check_whole
from gs2ci.api.runs import Run
from gs2ci.api.shots import load
from gs2ci.core.clock import command_age_s
from gs2ci.core.halt import Halt, halted_by_interruption
from gs2ci.core.progress import Progress
from gs2ci.core.records import FOCAL_RANGE_PX, Shot
from gs2ci.reconstruct.choices import (
    MOST_FITS,
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

if TYPE_CHECKING:
    from gs2ci.reconstruct.fit.density.base import DensityRule


def reconstruct(
    shot: Shot | str | Path,
    preset: PresetName = "standard",
    *,
    geometry: PoseSource | None = None,
    proxy: ProxyName | None = None,
    first_look: FirstLookName | None = None,
    budget: str | None = None,
    density: "RuleName | DensityRule | None" = None,
    without: tuple[str, ...] = (),
    iterations: int | None = None,
    fits: int | None = None,
    sh_degree: int | None = None,
    fine: bool = False,
    prior: str | None = None,
    distance: str | None = None,
    focal_px: float | None = None,
    trust_weights: bool = False,
    light: LightMode | None = None,
    within_mask: WithinMask | None = None,
    registration: RegistrationMode | None = None,
    motion: MotionMode | None = None,
    seed: int = 42,
    progress: Progress | None = None,
) -> Run:
    """Recover views, camera path and scene from one coded measurement.

    An interruption (Ctrl-C, a notebook's stop button) during the fit ends it: the run holds the best found so far, and
    says so (`run.interrupted`). Before the fit has begun, or the second time, it raises KeyboardInterrupt and leaves
    nothing behind.

    Args:
        shot: A shot, or a file that `load` takes.
        preset: How far to go: "draft" is a first look, "standard" the default, "fine" takes several times as long and
            ends with the fine stage, "paper" is the system of the GS2CI paper, constant by constant: 20,000 iterations
            without held-out pixels, and the scene's own views. Any other option changes what it names, and only that.
        geometry: Where the first poses come from: "tracks" finds them in the decoded views, "stage" takes those that
            the stage reported, "file:PATH" those of a COLMAP model's folder or a transforms.json, "vggt" (or
            "vggt:FILE") those that a model of yours predicts, "wide" matches points between all pairs of views, in
            whatever order, "uniform" seeks an even motion without tracks; "auto" takes the stage's where there are any
            and the measurement does not speak against them, else the tracks', else those of "wide", else an even
            motion; "vggt-or-tracks" takes VGGT's where you have added the model, else the tracks'. The
            fit refines them in any case. "auto" unless the preset says otherwise.
        proxy: The views that the geometry is found in: "gap-tv" for the decoded ones (unless the preset says
            otherwise), the paper's proxies "eni" or "amdi", "routed", the one of these two that the masks ask
            for, or "naive", the masked measurement, to compare with.
        first_look: What decodes before anything is fitted: "gap-tv", or "patches", slower and better by decibels, or
            "patches-quick", a few rounds of it. The preset's own when not given.
        budget: Instead of a preset, the time that everything together may take, as in 60s or 5min: the best that
            this machine can do by then.
        density: The rule by which Gaussians are added and removed, with the terms of the objective that belong to it,
            by its name (in Python also an object of your own, `gs2ci.reconstruct.fit.density.base`); the preset's own
            when not given.
        without: Components of the method to do without, for comparisons: points, poses, opacity-split,
            opacity-regulation, count-cap, pose-refinement.
        iterations: At most so many iterations of the fit; it ends earlier when held-out pixels stop improving.
        fits: How many fits run side by side; the views are their mean. More take longer and show more.
        sh_degree: How far colours may change with the direction they are seen from: the degree of their spherical
            harmonics, 0 (one colour whoever sees it) to 3; the preset's own when not given.
        fine: Go on with the fine stage: views from beside the cameras are held to what a prior on images says of them.
            Kept only where held-out pixels agree; with preset "paper", which holds none out, kept in any case.
        prior: For the fine stage, which it switches on: "consistent" (detail that several cameras agree on; the usual
            one), "nlm" (non-local means), "none", "difix" (added by `gs2ci models add`), or "onnx:FILE".
        distance: For the fine stage, which it switches on: "structure" (1 − SSIM over three scales), "lpips" (added
            by `gs2ci models add`), or "lpips:FILE".
        focal_px: Focal length along the rows to use instead of the shot's, in pixels.
        trust_weights: Take each mask's weight as the shot states it, whatever the measurement shows of the lamp.
        light: How bright the views are handed over where they were surely seen unlike one another: "as-seen"; "even",
            as under a lamp that does not flicker; "auto" is "even" where the shot tells weights that differ. The
            preset's own when not given.
        within_mask: "moving" where the camera goes on while a mask is on show: masks are then fitted with as many
            moments as that calls for, and the views show the middle of each; "still" where it stops under each, or
            where the measurement was coded in software. The preset's own when not given.
        registration: "auto" asks the measurement first where its masks lie and how they met the light, and corrects
            what it surely tells; "off" takes masks and readings as stated. The preset's own when not given.
        motion: Whether things in the scene may move by themselves: "auto" tries it where a still scene leaves what
            motion explains, and takes it where held-out pixels bear it out (not within a budget); "on" fits no still
            scene alone; "off" fits none that moves. The preset's own when not given.
        seed: Seed of every random draw; the same seed gives the same result.
        progress: Receives stages and steps; a bar at a terminal or in a notebook when None;
            `gs2ci.Silent()` shows nothing.

    Returns:
        The run.

    Raises:
        Gs2ciError: The shot or a value cannot be used, or the budget does not suffice.

    Example:
        >>> shot = gs2ci.load("measurement.npz", focal_px=40.0)
        >>> run = gs2ci.reconstruct(shot, preset="draft", iterations=4, progress=gs2ci.Silent())
        >>> run.views.shape, run.path.shape
        ((4, 24, 32, 3), (4, 4, 4))
        >>> run.save("recovered").name
        'recovered'
    """
    began_s = time.monotonic() - command_age_s()
    check_overrides(iterations, fits, focal_px, seed)
    measured = shot.check() if isinstance(shot, Shot) else load(shot)
    from gs2ci.api.overrides import Overrides, budget_seconds, score_against_truth, settings_of, with_focal
    from gs2ci.reconstruct import pipeline
    from gs2ci.reconstruct.presets.budget import Budget
    from gs2ci.render import backend

    overrides = Overrides(
        geometry=geometry,
        proxy=proxy,
        first_look=first_look,
        density=density,
        without=without,
        iterations=iterations,
        fits=fits,
        sh_degree=sh_degree,
        fine=fine,
        prior=prior,
        distance=distance,
        trust_weights=trust_weights,
        light=light,
        within_mask=within_mask,
        registration=registration,
        motion=motion,
        seed=seed,
    )
    budget_s = budget_seconds(budget, preset, overrides)
    measured = with_focal(focal_px, measured)
    settings, halt = settings_of(preset, overrides), Halt()
    within = None if budget_s is None else Budget(budget_s, began_s, overrides.on)
    with halted_by_interruption(halt), interrupted_within(), shown(progress) as display:
        if backend.needs_compiling(settings.backend):
            display.say(
                "The first run on this machine compiles the rasteriser, once, as `gs2ci compile` does ahead: "
                "give it half a minute more."
            )
        found = pipeline.reconstruct(measured, settings, display, score_against_truth(measured), within, halt)
    return Run.of(measured, found.result, found.scene)


def check_overrides(iterations: int | None, fits: int | None, focal_px: float | None, seed: int) -> None:
    """Accept the numbers that are requested, before anything is read.

    Raises:
        InputError: One is out of bounds.
    """
    check_whole("--iterations", iterations, 1)
    check_whole("--fits", fits, 1, MOST_FITS)
    check_number("--focal-px", focal_px, *FOCAL_RANGE_PX)
    check_seed(seed)
