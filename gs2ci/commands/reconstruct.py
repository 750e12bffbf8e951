"""`gs2ci reconstruct`: from a shot file to a run folder.

Here: the arguments, and the order read → reconstruct → write → tell. Not here: any of the four
(`gs2ci.api.reconstruction`).
"""

from pathlib import Path
from typing import Annotated, Any

import tyro

from gs2ci.api.display import open_display, print_summary
from gs2ci.api.options import check_whole
from gs2ci.api.reconstruction import check_wishes
from gs2ci.commands.answers import answered
from gs2ci.core.errors import InputError
from gs2ci.reconstruct.choices import (
    MOST_MOMENTS,
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


def run(
    shot: Annotated[Path, tyro.conf.Positional],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("run"),
    *,
    index: int = 0,
    geometry: PoseSource | None = None,
    proxy: ProxyName | None = None,
    first_look: FirstLookName | None = None,
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
    light: LightMode | None = None,
    within_mask: WithinMask | None = None,
    registration: RegistrationMode | None = None,
    motion: MotionMode | None = None,
    moments: int | None = None,
    seed: int = 42,
    overwrite: bool = False,
    more: Annotated[tuple[Path, ...], tyro.conf.Positional] = (),
    every: Annotated[bool, tyro.conf.arg(name="all")] = False,
    processes: int | None = None,
    scheduler: str = "",
    json: bool = False,
) -> Path:
    """Recover views, camera path and scene from one coded measurement, or from each of many.

    Ctrl-C during the fit ends it: the folder is written with the best found so far, a note in it says so, and the exit
    status is 130. A second Ctrl-C, or one before the fit, leaves everything as it was.

    Args:
        shot: A shot file, as `gs2ci import` and `gs2ci capture` write them.
        output: The run folder to write; for many exposures, the folder in which each gets its own.
        index: Which shot of the file.
        geometry: Where the first poses come from: "tracks" finds them in the decoded views, "stage" takes those that
            the stage reported, "file:PATH" those of a COLMAP model's folder or a transforms.json, "vggt" (or
            "vggt:FILE") those that a model of yours predicts, "wide" matches points between all pairs of views, in
            whatever order, "uniform" seeks an even motion without tracks; "auto" takes the stage's where there are any
            and the measurement does not speak against them, else the tracks', else those of "wide", else an even
            motion; "vggt-or-tracks" takes VGGT's where you have added the model, else the tracks'. The
            fit refines them in any case. "auto" unless the preset says otherwise.
        proxy: The views that the geometry is found in: "gap-tv" for the decoded ones (unless the preset says
            otherwise), or the paper's proxies "eni" or "amdi", or "routed", the one of these two that the masks ask
            for.
        first_look: What decodes before anything is fitted: "gap-tv", or "patches", slower and better by decibels, or
            "patches-quick", a few rounds of it. The preset's own when not given.
        preset: How far to go: "draft" is a first look, "standard" the default, "fine" takes several times as long and
            ends with the fine stage, "paper" is the system of the GS2CI paper, constant by constant: 20,000 iterations
            without held-out pixels, and the scene's own views. Any other option changes what it names, and only that.
        budget: Instead of a preset, the time that everything together may take, as in 60s or 5min: the best that
            this machine can do by then.
        density: The rule by which Gaussians are added and removed, with the terms of the objective that belong to it;
            the preset's own when not given.
        without: Components of the method to do without, for comparisons: points, poses, opacity-split,
            opacity-regulation, count-cap, pose-refinement.
        iterations: At most so many iterations of the fit; it ends earlier when held-out pixels stop improving.
        fits: How many fits run side by side; the views are their mean. More take longer and show more.
        fine: Go on with the fine stage: views from beside the cameras are held to what a prior on images says of them.
            Kept only where held-out pixels agree; with preset "paper", which holds none out, kept in any case.
        prior: For the fine stage, which it switches on: "consistent" (detail that several cameras agree on; what
            --fine takes), "nlm" (non-local means), "none", "difix" (added by `gs2ci models add`), or "onnx:FILE".
        distance: For the fine stage, which it switches on: "structure" (1 − SSIM over three scales), "lpips" (added
            by `gs2ci models add`), or "lpips:FILE".
        focal_px: Focal length along the rows to use instead of the file's, in pixels.
        trust_weights: Take each mask's weight as the file states it, whatever the measurement shows of the lamp.
        light: How bright the views are handed over where they were surely seen unlike one another: "as-seen"; "even",
            as under a lamp that does not flicker; "auto" is "even" where the file tells weights that differ.
        within_mask: "moving" where the camera goes on while a mask is on show: masks are then fitted with as many
            moments as that calls for, and the views show the middle of each. "still" (the default) where it stops under
            each, or where the measurement was coded in software.
        registration: "auto" asks the measurement first where its masks lie and how they met the light, and corrects
            what it surely tells; "off" believes masks and readings as they are.
        motion: Whether things in the scene may move by themselves: "auto" tries it where a still scene leaves what
            motion explains, and takes it where held-out pixels bear it out (not within a budget); "on" fits no still
            scene alone; "off" fits none that moves.
        moments: Write so many pictures as well, spread evenly over the exposure: slow motion, where there are more of
            them than masks. They show the scene alone, at times and from places between those of the masks.
        seed: Of every random draw; the same seed gives the same result.
        overwrite: Replace an earlier run at the same place.
        more: More shot files. Of many exposures each is reconstructed; what is done already is left as it is.
        every: Reconstruct every exposure of every file.
        processes: How many exposures at once on this machine; as many as its cores and memory bear, if not given.
        scheduler: Address of a Dask scheduler whose workers do it instead, e.g. tcp://host:8786; they see the same
            paths.
        json: Print the answer as JSON, and nothing else, on standard output.

    Returns:
        The folder.

    Raises:
        Gs2ciError: The file, a value or the destination cannot be used, or the budget does not suffice; the folder
            is then as it was.
        KeyboardInterrupt: The user interrupted; during the fit, the folder is written first.
    """
    check_wishes(iterations, fits, focal_px, seed)
    check_whole("--moments", moments, 2, MOST_MOMENTS)
    many = bool(more) or every or bool(scheduler) or processes is not None
    if many and moments is not None:
        raise InputError("--moments of many exposures", remedy="ask for them of each exposure by itself, with --index")
    if many and budget is not None:
        raise InputError("--budget for many exposures", remedy="give a --preset: machines differ, and so would results")
    wishes: dict[str, Any] = {
        "geometry": geometry,
        "proxy": proxy,
        "first_look": first_look,
        "density": density,
        "without": without,
        "iterations": iterations,
        "fits": fits,
        "fine": fine,
        "prior": prior,
        "distance": distance,
        "focal_px": focal_px,
        "trust_weights": trust_weights,
        "light": light,
        "within_mask": within_mask,
        "registration": registration,
        "motion": motion,
        "seed": seed,
    }
    if many:
        if json:
            raise InputError("--json for many exposures", remedy="leave it out: runs.csv in the folder has a line each")
        from gs2ci.commands.many import run_many

        return run_many(
            (shot, *more),
            output,
            preset,
            wishes,
            every=every,
            index=index,
            processes=processes,
            scheduler=scheduler,
            overwrite=overwrite,
        )
    from gs2ci.core.storage import read_shot

    measured = read_shot(shot, index)
    from gs2ci.api import reconstruction
    from gs2ci.evaluate.run_folder import check_destination

    check_destination(output, overwrite=overwrite)
    with answered(as_text=not json) as answer:
        with open_display() as display:
            found = reconstruction.reconstruct(measured, preset, budget=budget, progress=display, **wishes)
            display.stage("report")
            found.save(output, overwrite=overwrite, moments=moments)
        print_summary(output)
        answer({"folder": output, **found.report.model_dump(mode="json", by_alias=True)})
    if found.interrupted:
        # The run is there, and whoever scripts this learns by the status that it is not what was asked for.
        raise KeyboardInterrupt
    return output
