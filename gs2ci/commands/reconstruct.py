"""`gs2ci reconstruct`: from a shot file to a run folder.

Here: the arguments, and the order read → plan → reconstruct → write → tell. Not here: any of the five; what the
arguments mean for settings and shot (`wishes`).
"""

import time
from pathlib import Path
from typing import Annotated, Final

import tyro

from gs2ci.commands.display import open_display, print_summary
from gs2ci.commands.options import check_number, check_seed, check_whole
from gs2ci.core.clock import command_age_s
from gs2ci.core.records import FOCAL_RANGE_PX
from gs2ci.reconstruct.choices import (
    MOST_FITS,
    MotionMode,
    PoseSource,
    PresetName,
    ProxyName,
    RegistrationMode,
    RuleName,
)

# Each is a picture, and where things move a scene file.
_MOST_MOMENTS: Final = 1000


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
    registration: RegistrationMode = "auto",
    motion: MotionMode = "auto",
    moments: int | None = None,
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
            "vggt:FILE") those that a model of yours predicts, "uniform" seeks an even motion without tracks; "auto"
            takes the stage's where there are any and the measurement does not speak against them, else the tracks',
            else an even motion. The fit refines them in any case.
        proxy: The views that the geometry is found in: decoded by "gap-tv", or "eni" or "amdi", the paper's proxies.
        preset: How far to go: "draft" is a first look, "standard" the default, "fine" takes several times as long and
            ends with the fine stage, "paper" is the schedule of the GS2CI paper, 20,000 iterations without held-out
            pixels.
        budget: Instead of a preset, the time that everything together may take, as in 60s or 5min: the best that
            this machine can do by then.
        density: The rule by which Gaussians are added and removed, with the terms of the objective that belong to it;
            the preset's own when not given.
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
        registration: "auto" asks the measurement first where its masks lie and how they met the light, and corrects
            what it surely tells; "off" believes masks and readings as they are.
        motion: Whether things in the scene may move by themselves: "auto" tries it where a still scene leaves what
            motion explains, and takes it where held-out pixels bear it out (not within a budget); "on" fits no still
            scene alone; "off" fits none that moves.
        moments: Write so many pictures as well, spread evenly over the exposure: slow motion, where there are more of
            them than masks. They show the scene alone, at times and from places between those of the masks.
        seed: Of every random draw; the same seed gives the same result.
        overwrite: Replace an earlier run at the same place.

    Returns:
        The run folder.

    Raises:
        Gs2ciError: The file, a value or the destination cannot be used, or the budget does not suffice; the folder
            is then as it was.
    """
    began_s = time.monotonic() - command_age_s()
    check_whole("--iterations", iterations, 1)
    check_whole("--fits", fits, 1, MOST_FITS)
    check_whole("--moments", moments, 2, _MOST_MOMENTS)
    check_number("--focal-px", focal_px, *FOCAL_RANGE_PX)
    check_seed(seed)
    from gs2ci.core.storage import read_shot

    measured = read_shot(shot, index)
    from gs2ci.commands.wishes import Wishes, budget_seconds, planned, score_against_truth, with_focal
    from gs2ci.evaluate.run_folder import check_destination, write_run
    from gs2ci.reconstruct.pipeline import reconstruct
    from gs2ci.reconstruct.presets import PRESETS
    from gs2ci.render.backend import needs_compiling

    wishes = Wishes(
        *(geometry, proxy, density, without, iterations, fits, fine, prior, distance),
        *(trust_weights, registration, motion, seed),
    )
    budget_s = budget_seconds(budget, preset, wishes)
    check_destination(output, overwrite=overwrite)
    measured = with_focal(focal_px, measured)
    settings, pace = wishes.on(PRESETS[preset]), None
    with open_display() as display:
        if needs_compiling(settings.backend):
            display.say("The first run on this machine compiles the rasteriser, once: give it half a minute more.")
        if budget_s is not None:
            plan = planned(budget_s, began_s, measured, wishes.on, display)
            settings, pace = plan.settings, plan.pace
        found = reconstruct(measured, settings, display, score_against_truth(measured), pace)
        display.stage("report")
        write_run(output, measured, found.result, found.scene, overwrite=overwrite, moments=moments)
    print_summary(output)
    return output
