"""From a shot to a run: read the wishes, plan, reconstruct.

Here: the order of these, with the progress shown. Not here: what wishes mean for settings and shot (`wishes`), the
reconstruction (`gs2ci.reconstruct.pipeline`).
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
        preset: "draft" is a first look, "standard" the default, "fine" takes several times as long, "paper" is the
            system of the GS2CI paper. Any other argument changes what it names, and only that.
        geometry: Where the first poses come from: "auto", "tracks", "stage", "wide", "uniform", "file:PATH", "vggt",
            "vggt:FILE" or "vggt-or-tracks"; the preset's own when None.
        proxy: The views that the geometry is found in: "gap-tv", "eni", "amdi" or "routed"; the preset's own when None.
        first_look: What decodes before anything is fitted: "gap-tv", "patches" or "patches-quick"; the preset's own
            when None.
        budget: Instead of a preset, the time that everything may take, as in "60s" or "5min".
        density: The rule by which Gaussians are added and removed: its name, or an object of your own
            (`gs2ci.reconstruct.fit.density.base`); the preset's own when None.
        without: Components to do without, for comparisons.
        iterations: At most so many iterations of the fit.
        fits: How many fits the views are the mean of.
        fine: Go on with the fine stage.
        prior: For the fine stage, which it switches on: "consistent", "nlm", "none", "difix" or "onnx:FILE".
        distance: For the fine stage, which it switches on: "structure", "lpips" or "lpips:FILE".
        focal_px: Focal length along the rows to use instead of the shot's, in pixels.
        trust_weights: Take each mask's weight as the shot states it.
        light: How bright the views are where they were seen unlike one another: "as-seen", "even", or "auto", even
            where the shot tells weights that differ; the preset's own when None.
        within_mask: "moving" where the camera goes on while a mask is on show; "still" where it stops, or where the
            measurement was coded in software; the preset's own when None.
        registration: "auto" asks the measurement where its masks lie; "off" believes them; the preset's own when None.
        motion: Whether things in the scene may move: "auto" where a still scene leaves what motion explains; "on" no
            still scene alone; "off" none that moves; the preset's own when None.
        seed: Of every random draw; the same seed gives the same result.
        progress: Who hears of stages and steps; a bar at a terminal or in a notebook when None;
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
    check_wishes(iterations, fits, focal_px, seed)
    measured = shot.check() if isinstance(shot, Shot) else load(shot)
    from gs2ci.api.wishes import Wishes, budget_seconds, score_against_truth, settings_of, with_focal
    from gs2ci.reconstruct import pipeline
    from gs2ci.reconstruct.budget import Budget
    from gs2ci.render import backend

    wishes = Wishes(
        geometry=geometry,
        proxy=proxy,
        first_look=first_look,
        density=density,
        without=without,
        iterations=iterations,
        fits=fits,
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
    budget_s = budget_seconds(budget, preset, wishes)
    measured = with_focal(focal_px, measured)
    settings, halt = settings_of(preset, wishes), Halt()
    within = None if budget_s is None else Budget(budget_s, began_s, wishes.on)
    with halted_by_interruption(halt), interrupted_within(), shown(progress) as display:
        if backend.needs_compiling(settings.backend):
            display.say(
                "The first run on this machine compiles the rasteriser, once, as `gs2ci compile` does ahead: "
                "give it half a minute more."
            )
        found = pipeline.reconstruct(measured, settings, display, score_against_truth(measured), within, halt)
    return Run.of(measured, found.result, found.scene)


def check_wishes(iterations: int | None, fits: int | None, focal_px: float | None, seed: int) -> None:
    """Accept the numbers that are asked for, before anything is read.

    Raises:
        InputError: One is out of bounds.
    """
    check_whole("--iterations", iterations, 1)
    check_whole("--fits", fits, 1, MOST_FITS)
    check_number("--focal-px", focal_px, *FOCAL_RANGE_PX)
    check_seed(seed)
