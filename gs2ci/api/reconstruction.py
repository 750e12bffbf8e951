"""From a shot to a run: settings, budget, reconstruct.

Here: the order of these, with the progress shown. Not here: what arguments change of settings and shot
(`overrides`), the reconstruction (`gs2ci.reconstruct.pipeline`).
"""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gs2ci.api.display import interrupted_within, shown
from gs2ci.api.options import check_number, check_seed, check_whole
from gs2ci.api.preparing import prepare_first_run
from gs2ci.api.runs import Run
from gs2ci.api.shots import every_exposure, load
from gs2ci.core.clock import command_age_s
from gs2ci.core.errors import InputError
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
    from gs2ci.reconstruct.hypotheses.plan import RacePlan


def reconstruct(
    shot: Shot | str | Path | Sequence[Shot | str | Path],
    preset: PresetName = "standard",
    *,
    together: bool = False,
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
    device: str = "auto",
    seed: int = 42,
    unfinished: str | Path | None = None,
    progress: Progress | None = None,
) -> Run:
    """Recover views, camera path and scene from one coded measurement.

    An interruption (Ctrl-C, a notebook's stop button) during the fit ends the fit: the run is then the best found so
    far, and `run.interrupted` is true. Before the fit, or the second time, it raises KeyboardInterrupt and nothing is
    written.

    Args:
        shot: A shot, or a file that `load` takes; with `together` several of them, or a file of several exposures.
        together: Recover one scene from several exposures of it: from all of a file, or of a list. Each keeps its own
            views and path; those that nothing ties to the others are left out by name. Not with a budget, and only of
            scenes that stand still.
        preset: Speed or quality: "draft" is a first look, "standard" the default, "paper" uses the
            constants of the GS2CI paper's system: 20,000 iterations without held-out pixels, and the scene's own views.
            Each other option changes only what it names.
        geometry: Source of the first poses: "tracks" estimates them from the decoded views, "stage" uses those that
            the stage reported, "file:PATH" those of a COLMAP model's folder or a transforms.json, "vggt" (or
            "vggt:FILE") those that your model predicts, "wide" matches points between all pairs of views, in any
            order, "displacements" explains how far blocks of the picture move, "rest" takes the camera to be at rest;
            "auto" takes it to be at rest if the measurement shows so, otherwise it uses the stage's poses if there are
            any and the measurement does not contradict them, otherwise tracks, or displacements if tracks show no path
            or a doubtful one, then "wide"; "vggt-or-tracks" uses VGGT's if you have added the model, otherwise tracks.
            The fit refines them, but not those of a camera at rest. "auto" unless the preset says otherwise.
        proxy: The views from which the geometry is estimated: "gap-tv" for the decoded ones (unless the preset says
            otherwise), the paper's proxies "eni" or "amdi", "routed", which chooses one of these two by the masks, or
            "naive", the masked measurement, for comparison.
        first_look: The decoder before the fit: "gap-tv", or "patches", slower and better by decibels, or
            "patches-quick", the same with a few steps. By default the preset's.
        budget: Instead of a preset, the time for everything together, such as 60s or 5min: the best result that this
            machine can deliver in that time.
        density: The rule that adds and removes Gaussians, with its terms of the objective, by its name (in Python also
            your own object, `gs2ci.reconstruct.fit.density.base`); by default the preset's.
        without: Components of the method to switch off, for comparisons: points, poses, opacity-split,
            opacity-regulation, count-cap, pose-refinement.
        iterations: Maximum number of iterations of the fit; it ends earlier when held-out pixels stop improving.
        fits: Number of fits that run side by side; the views are their mean. More are slower and more accurate.
        sh_degree: Degree of the spherical harmonics by which colours depend on the viewing direction, 0 (one colour
            in all directions) to 3; by default the preset's.
        fine: Add the fine stage: views beside the cameras are improved by an image prior and fitted. Kept only if the
            held-out pixels improve; with preset "paper", which holds none out, kept in any case.
        prior: Of the fine stage, which it switches on: "none" (the default), "difix" (added by `gs2ci
            models add`), or "onnx:FILE".
        distance: Of the fine stage, which it switches on: "structure" (1 − SSIM over three scales), "lpips" (added
            by `gs2ci models add`), or "lpips:FILE".
        focal_px: Focal length along the rows to use instead of the shot's, in pixels.
        trust_weights: Use each mask's weight as the shot states it, even if the measurement shows another.
        light: Brightness of the delivered views if it varied significantly from view to view: "as-seen"; "even", as
            under a lamp that does not flicker; "auto" is "even" if the shot states weights that differ. By default the
            preset's.
        within_mask: "moving" if the camera moves while a mask is shown: each mask is then fitted with as many moments
            as its motion requires, and the views show the middle of each; "still" if the camera stops under each, or
            if the measurement was coded in software. By default as the shot states (captures and simulated exposures
            do), otherwise "still".
        registration: "auto" first estimates from the measurement where its masks lie, how they are blurred and in
            which unit it was read, and corrects significant errors; "off" uses masks and readings as stated. By
            default the preset's.
        motion: Whether things in the scene may move: "auto" tries it if motion explains part of the residual of a
            static scene, and uses it if held-out pixels confirm it (not with a budget); "on" always fits a moving
            scene; "off" never. By default the preset's.
        device: What renders: "cpu", "cuda" for the first CUDA device that works, "cuda:1" for one of several; "auto"
            takes a CUDA device that works, otherwise the CPU, and the run says what kept a card from being used.
        seed: Seed of every random draw; the same seed gives the same result.
        unfinished: With `together`, a folder in which what is done is kept, so that the same call goes on after its
            process was killed; `Run.save` removes it, but for that of a run that was interrupted.
        progress: Receives stages and steps; a bar at a terminal or in a notebook when None;
            `gs2ci.Silent()` shows nothing.

    Returns:
        The run.

    Raises:
        Gs2ciError: The shot or a value cannot be used.

    Example:
        >>> shot = gs2ci.load("measurement.npz", focal_px=40.0)
        >>> run = gs2ci.reconstruct(shot, preset="draft", iterations=4, progress=gs2ci.Silent())
        >>> run.views.shape, run.path.shape
        ((4, 24, 32, 3), (4, 4, 4))
        >>> run.save("recovered").name
        'recovered'
    """
    given = locals()
    began_s = time.monotonic() - command_age_s()
    check_overrides(given)
    shots = [with_focal_of(one, focal_px) for one in every_exposure(shot, together=together)]
    from gs2ci.api.overrides import Overrides, budget_seconds, score_against_truth, settings_of
    from gs2ci.reconstruct import pipeline
    from gs2ci.reconstruct.exposures.joint import reconstruct_together
    from gs2ci.reconstruct.presets.budget import Budget

    overrides = Overrides(**{name: given[name] for name in Overrides.__dataclass_fields__})
    budget_s = budget_seconds(budget, preset, overrides)
    if together and budget_s is not None:
        raise InputError("--together within a budget", allowed="a preset", remedy="leave out one of the two")
    if unfinished is not None and not together:
        raise InputError("a folder for an unfinished run of one exposure", allowed="one with together=True")
    settings, halt = settings_of(preset, overrides), Halt()
    within = None if budget_s is None else Budget(budget_s, began_s, overrides.on)
    with (
        shown(progress) as display,
        # What a joint run has done is kept on the disk, from where a killed one goes on.
        halted_by_interruption(halt, display.say, told_to_end=unfinished is None),
        interrupted_within(),
    ):
        prepare_first_run(settings.backend, display)
        scores = [score_against_truth(one) for one in shots]
        if together:
            kept = None if unfinished is None else Path(unfinished)
            joint = reconstruct_together(shots, settings, display, scores, halt, kept)
            return Run.of(joint.shot, joint.result, joint.scene, None if halt.asked else kept)
        found = pipeline.reconstruct(shots[0], settings, display, scores[0], within, halt)
    return Run.of(shots[0], found.result, found.scene)


def foresee(
    shot: Shot | str | Path,
    preset: PresetName = "standard",
    *,
    budget: str | None = None,
    focal_px: float | None = None,
    progress: Progress | None = None,
    **overrides: Any,
) -> "RacePlan":
    """Foresee which hypotheses `reconstruct` would fit, what each would cost and why, without fitting any.

    The measurement is registered, decoded and tracked, and a few iterations of a fit are timed.

    Args:
        shot: As for `reconstruct`.
        preset: Likewise.
        budget: Refused: within a budget, the costs decide what is fitted.
        focal_px: As for `reconstruct`.
        progress: Receives stages and steps.
        **overrides: All other arguments of `reconstruct`.

    Returns:
        The plan; printed, it is a table.

    Raises:
        Gs2ciError: The shot or a value cannot be used, or a budget is given.
    """
    check_overrides({**overrides, "focal_px": focal_px})
    if budget is not None:
        remedy = "leave out one of the two: `--budget` says itself what it fits"
        raise InputError("--explain-plan within a budget", allowed="a preset", remedy=remedy)
    measured = with_focal_of(shot, focal_px)
    from gs2ci.api.overrides import Overrides, settings_of
    from gs2ci.reconstruct import pipeline

    with shown(progress) as display:
        return pipeline.plan(measured, settings_of(preset, Overrides(**overrides)), display)


def with_focal_of(shot: Shot | str | Path, focal_px: float | None) -> Shot:
    """Return a shot, read if it is a file, with another focal length if one is given."""
    from gs2ci.api.overrides import with_focal

    return with_focal(focal_px, shot.check() if isinstance(shot, Shot) else load(shot))


def check_overrides(given: Mapping[str, Any]) -> None:
    """Check the numbers among arguments of `reconstruct`, before anything is read.

    Raises:
        InputError: One is out of bounds.
    """
    check_whole("--iterations", given.get("iterations"), 1)
    check_whole("--fits", given.get("fits"), 1, MOST_FITS)
    check_number("--focal-px", given.get("focal_px"), *FOCAL_RANGE_PX)
    check_seed(given.get("seed", 42))
