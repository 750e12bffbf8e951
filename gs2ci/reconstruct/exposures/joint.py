"""One scene from several exposures.

    observe each ─► decode repeats together ─► tie them into common coordinates ─► first Gaussians of all ─► one fit ─►
    each one's views ─► record

Here: the order of these, and the record of the whole. Not here: a single exposure's stages (`observe`, `fusion`), where
exposures lie (`places`), the fit (`fit.coarse.stage`).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from gs2ci.core.cameras import camera_centres
from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.core.halt import Halt
from gs2ci.core.progress import Progress, Silent, said
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult
from gs2ci.core.summed import in_one_frame, summed
from gs2ci.reconstruct.exposures import foreseen
from gs2ci.reconstruct.exposures.merging import merged, side_by_side, with_what_each_gave
from gs2ci.reconstruct.exposures.observing import Keeping, PlacedExposure, first_of_all, observe_all
from gs2ci.reconstruct.exposures.places import CommonPlaces, places
from gs2ci.reconstruct.exposures.repeats import decoded_together
from gs2ci.reconstruct.exposures.unfinished import Unfinished, arrays_of, key_of_run
from gs2ci.reconstruct.fit.coarse.looks import Monitoring, Score
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse.stage import CoarseFit, CoarseRun
from gs2ci.reconstruct.fit.combining.ensemble import Ensemble
from gs2ci.reconstruct.fit.combining.metric import in_given_unit
from gs2ci.reconstruct.fusion import hand_over
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.hypotheses.moving import MotionReport
from gs2ci.reconstruct.hypotheses.race import Raced
from gs2ci.reconstruct.observe import KeptObservation, Observed, Tools, observe
from gs2ci.reconstruct.placing import placed as on_device
from gs2ci.reconstruct.record import Left, record
from gs2ci.reconstruct.settings import Settings
from gs2ci.reconstruct.stopwatch import Stopwatch
from gs2ci.reconstruct.threads import one_torch_thread
from gs2ci.reconstruct.uncertainty.of_run import how_sure
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.interface import Backend
from gs2ci.render.places import working_on

# Observations of exposures that an unfinished run keeps.


def observations(unfinished: Unfinished, tools: Tools, progress: Progress) -> Keeping:
    """Return what observes exposures that are not observed yet, and keeps what they show on the disk."""

    def kept(number: int, shot: Shot, settings: Settings, score: Score | None) -> Callable[[], Observed]:
        def see() -> KeptObservation:
            return KeptObservation.of(observe(shot, settings, tools, progress, score, Halt(), None))

        read = unfinished.done(f"exposure-{number:03}", see, arrays_of(shot))
        return lambda: read().observed(shot, settings, progress, score)

    return kept


# The schedule of a fit to several exposures, from that of a fit to one.

# Iterations grow with this power of the number of exposures, of which each iteration sees one.
_GROWTH: Final = 0.5


def shared_schedule(fit: CoarseSettings, exposures: int, growth: float) -> CoarseSettings:
    """Return the schedule of a fit to so many exposures; that of one is unchanged.

    Looks and turns of the density rule stay as many, and lie a whole number of rounds apart, so that each has seen
    every exposure equally often.

    Args:
        fit: The schedule for one.
        exposures: How many.
        growth: How many times as many first Gaussians there are as for one, which the population's bound follows.
    """
    if exposures == 1:
        return fit
    stretch = exposures**_GROWTH
    between, hold_out = _rounds(fit.densify_every * stretch, exposures), fit.hold_out
    return replace(
        fit,
        iterations=_rounds(fit.iterations * stretch, exposures),
        densify_every=between,
        hold_out=replace(
            hold_out,
            look_every=_rounds(hold_out.look_every * stretch, exposures),
            patience=_rounds(hold_out.patience * stretch, exposures),
            growth_patience=_rounds(hold_out.growth_patience * stretch, exposures),
        ),
        gaussians_per_pixel=None if fit.gaussians_per_pixel is None else fit.gaussians_per_pixel * max(1.0, growth),
    )


def _rounds(iterations: float, exposures: int) -> int:
    """Return about so many iterations that are whole rounds, one at least."""
    return exposures * max(1, math.ceil(iterations / exposures - 0.5))


@dataclass(frozen=True, eq=False)
class Joint:
    """The result for several exposures.

    Args:
        shot: Their sum (`core.summed`), as they were given; the record has that of the registered ones.
        result: The record of all their views, those of one exposure after the other.
        scene: The Gaussians, which all share.
        parts: The record of each exposure, its path in the coordinates of the scene.
        left_out: Why an exposure is not among them.
    """

    shot: Shot
    result: RunResult
    scene: Gaussians
    parts: tuple[RunResult, ...]
    left_out: Findings


@one_torch_thread()
def reconstruct_together(
    shots: Sequence[Shot],
    settings: Settings | None = None,
    progress: Progress | None = None,
    scores: Sequence[Score | None] | None = None,
    halt: Halt | None = None,
    unfinished: Path | None = None,
) -> Joint:
    """Recover one scene, and the views and the path of each exposure, from several coded measurements of it.

    Args:
        shots: One or more, of one camera; their truths are not read. The first one's coordinates become those of all.
        settings: Of every stage. Things in the scene do not move in a reconstruction of several exposures.
        progress: Receives every stage and step.
        scores: Turn each one's views into a figure for the curve, in dB; they may know the truth.
        halt: A request to end early with the result so far; it can be made as soon as the fit has begun.
        unfinished: A folder in which everything that is done is kept until the caller removes it; what it holds of an
            earlier start with the same arguments is not done again. None: nothing is kept on the disk, and all
            exposures lie in memory.

    Raises:
        InputError: The exposures are not of one camera, the settings let things move, or they name a CUDA device that
            cannot be used.
        ResourceError: The settings name a CUDA device that has too little memory.
        GeometryError: Nothing ties any two exposures to each other.
        StorageError: The folder holds something else, or cannot be written.
        NumericsError: The fit is not finite from its first iteration on.
    """
    settings, progress, halt = (settings or Settings()).check(), progress or Silent(), halt or Halt()
    shots = in_one_frame(shots)
    if settings.motion == "on":
        raise InputError(
            "several exposures of a scene in which things move",
            allowed="a scene that stands still while all of them are taken",
            remedy="reconstruct each exposure by itself, without --together",
        )
    if settings.fine is not None or settings.withheld is not None:
        raise InputError(
            "a fine stage, or withheld points or poses, with several exposures",
            allowed="the presets draft and standard, and no --fine, --prior, --distance or --without points or poses",
            remedy="leave these out, or reconstruct each exposure by itself",
        )
    settings, where_rendered = on_device(shots[0], settings, exposures=len(shots))
    said(where_rendered.notes, progress)
    settings, clock = replace(settings, motion="off"), Stopwatch()
    several = len(shots) > 1
    if several:
        progress.say(foreseen.said(shots))
    kept = None
    if unfinished is not None and several:
        kept = Unfinished(unfinished, key_of_run(shots, settings))
    tools = Tools.load(settings)
    keeping = None if kept is None else observations(kept, tools, progress)
    with working_on(tools.backend.device), nullcontext() if kept is None else kept.alone():
        if kept is not None:
            kept.begin(progress)
            clock = Stopwatch.after({"total": kept.before_s})
        alone = list(observe_all(shots, settings, tools, progress, scores or [None] * len(shots), keeping))
        observed, repeating = decoded_together(alone, settings, tools.geometry_prior, progress)
        where = places(observed) if kept is None else kept.done("places", partial(places, observed))()
        placed = where.of(observed)
        said((*where.left_out, *where.notes), progress)
        clock.lap("geometry")
        halt.begin()
        fit = _fitted(placed, settings, Monitoring(progress, clock.began_s, halt), kept, tools.backend)
        clock.lap("fit")
        joint = _handed_over(placed, where, fit, settings, tools.backend, progress, clock, None if halt.asked else kept)
    notes = (*where_rendered.notes, *repeating, *joint.result.notes, *halt.told(progress))
    return replace(joint, result=replace(joint.result, device=where_rendered.device, notes=notes))


def _fitted(
    placed: Sequence[PlacedExposure],
    settings: Settings,
    monitoring: Monitoring,
    kept: Unfinished | None,
    backend: Backend,
) -> CoarseRun:
    """Fit one scene to all exposures."""
    start, growth = first_of_all([one.at.start for one in placed], [one.at.geometry for one in placed])
    run = CoarseRun(
        [one.to_fit(backend) for one in placed],
        start,
        shared_schedule(settings.fit, len(placed), growth),
        settings.seed,
        monitoring,
        keeper=kept,
    )
    run.advance()
    return run


def _handed_over(
    placed: Sequence[PlacedExposure],
    where: CommonPlaces,
    fit: CoarseRun,
    settings: Settings,
    backend: Backend,
    progress: Progress,
    clock: Stopwatch,
    kept: Unfinished | None,
) -> Joint:
    """Make the views of each exposure that are delivered, and the record of all."""
    progress.stage("views", len(placed))
    given = _in_given_unit(placed, fit)

    def made() -> Iterator[RunResult]:
        for number, one in enumerate(placed):
            make = partial(_part, one, fit, number, given, settings, backend, clock)
            yield make() if kept is None else kept.done(f"part-{number:03}", make, arrays_of(one.of.given))()
            progress.step(number + 1)

    parts = side_by_side(made(), sum(len(one.at.geometry.world_to_camera) for one in placed))
    clock.lap("views")
    names, shots = [one.of.name for one in placed], [one.of.shot for one in placed]
    name = names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
    together = (finding(Code.EXPOSURES_TOGETHER, exposures=len(parts)),) if len(parts) > 1 else ()
    seconds = {**clock.seconds(), "decode": sum(one.seconds["decode"] for one in parts)}
    result = merged(parts, names, (*where.left_out, *where.notes, *together), seconds)
    result = with_what_each_gave(result)
    if any(part.registered is not None for part in parts):
        # A camera matrix that was estimated is in the record, and belongs to no measurement.
        registered = [
            replace(shot, intrinsics=one.of.given.intrinsics) for shot, one in zip(shots, placed, strict=True)
        ]
        result = replace(result, registered=summed(registered, name))
    whole = summed([one.of.given for one in placed], name)
    return Joint(whole, result, given[0][1].scene, tuple(parts), where.left_out)


def _part(
    one: PlacedExposure,
    run: CoarseRun,
    number: int,
    given: Sequence[tuple[Geometry, CoarseFit]],
    settings: Settings,
    backend: Backend,
    clock: Stopwatch,
) -> RunResult:
    """Return the record of one exposure.

    Args:
        one: The exposure.
        run: The fit of the common scene.
        number: Of the exposure in the fit.
        given: The path of each and the common scene along it, in the unit of the given poses, without views.
        settings: Of the reconstruction.
        backend: Renders.
        clock: Of the whole.
    """
    observed, fit = one.of.observed, run.result(number)
    first, fits = observed.first, observed.fits
    ensemble, renderer = Ensemble(fit, fit.views), one.renderer(observed.fits, backend)
    recovered = hand_over(first, ensemble, fits.refine, fits.settings, ()).in_the_middle(ensemble, renderer)
    geometry, scaled = given[number][0], replace(given[number][1], views=fit.views)
    light = renderer.stopped_light(scaled.scene, scaled.world_to_camera)
    raced = Raced(first, first, geometry, (scaled,), Ensemble(scaled, scaled.views), observed.order, _STILL, ())
    left = Left(
        observed.registered,
        observed.doubts,
        first,
        raced,
        geometry,
        raced.ensemble,
        light,
        recovered,
        None,
        fits.mask_moments,
    )
    if settings.uncertainty:
        # The first and the last camera of each stand for it: that all would tell more is worth less than their time.
        ends = [path.world_to_camera[[0, -1]] for known, path in given if known.pose_errors and known is not geometry]
        others = np.concatenate(ends) if ends else None
        places = np.concatenate([camera_centres(path.world_to_camera) for _, path in given])
        sure = how_sure(first, geometry, raced.ensemble, recovered, renderer, light, others, places)
        left = replace(left, uncertainty=sure)
    clock.lap("fit")
    seconds = {"geometry": 0.0, "decode": 0.0, "fit": 0.0, **fits.clock.seconds()}
    return record(replace(settings, fits=1, seed=fits.settings.seed), left, fits.score, seconds)


def _in_given_unit(placed: Sequence[PlacedExposure], fit: CoarseRun) -> tuple[tuple[Geometry, CoarseFit], ...]:
    """Return the first path of each exposure, and the fit along its path without views.

    With lengths in the unit of the given poses, one for all.
    """
    geometries, paths = [one.at.geometry for one in placed], fit.paths()
    best = replace(fit.result(), world_to_camera=np.concatenate(paths))
    unit = next((one.unit for one in geometries if one.unit is not None), None)
    before = np.concatenate([one.world_to_camera for one in geometries])
    every = replace(geometries[0], world_to_camera=before, unit=unit)
    whole, ensemble = in_given_unit(every, Ensemble(best, best.views))
    scaled, found, at = replace(ensemble.best, views=best.views[:0]), [], 0
    for own, path in zip(geometries, paths, strict=True):
        views = slice(at, at + len(path))
        # Lengths of the first path and its depth are those of the common coordinates, or of the given unit.
        geometry = replace(
            own,
            world_to_camera=whole.world_to_camera[views],
            inverse_depth=(own.inverse_depth / (whole.unit or 1.0)).astype(np.float32),
            unit=own.unit and whole.unit,
        )
        fitted = scaled.world_to_camera[views]
        found.append((geometry, replace(scaled, world_to_camera=fitted, intrinsics=own.intrinsics)))
        at = views.stop
    return tuple(found)


_STILL: Final = MotionReport("off")
