"""One scene from several exposures.

    observe each ─► decode repeats together ─► tie them into common coordinates ─► first Gaussians of all ─► one fit ─►
    each one's views ─► record

Here: the order of these, and the record of the whole. Not here: a single exposure's stages (`observe`, `fusion`), where
exposures lie (`places`), the fit (`fit.coarse.stage`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from gs2ci.core.errors import InputError
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.halt import Halt
from gs2ci.core.progress import Progress, Silent
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult
from gs2ci.core.summed import check_alike, summed
from gs2ci.reconstruct.exposures.merging import merged
from gs2ci.reconstruct.exposures.observing import PlacedExposure, observe_all
from gs2ci.reconstruct.exposures.places import CommonPlaces, places
from gs2ci.reconstruct.exposures.placing import first_of_all
from gs2ci.reconstruct.exposures.repeats import decoded_together
from gs2ci.reconstruct.exposures.schedule import shared_schedule
from gs2ci.reconstruct.fit.coarse.looks import Monitoring, Score
from gs2ci.reconstruct.fit.coarse.stage import CoarseFit, CoarseRun
from gs2ci.reconstruct.fit.combining.ensemble import Ensemble
from gs2ci.reconstruct.fit.combining.metric import in_given_unit
from gs2ci.reconstruct.fit.one_thread import one_torch_thread
from gs2ci.reconstruct.fusion import hand_over
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.hypotheses.moving import MotionReport
from gs2ci.reconstruct.hypotheses.race import Raced
from gs2ci.reconstruct.observe import Tools
from gs2ci.reconstruct.placing import placed as on_device
from gs2ci.reconstruct.record import Left, record
from gs2ci.reconstruct.settings import Settings
from gs2ci.reconstruct.stopwatch import Stopwatch
from gs2ci.reconstruct.uncertainty.of_run import how_sure
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.places import working_on


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
    left_out: tuple[Finding, ...]


@one_torch_thread()
def reconstruct_together(
    shots: Sequence[Shot],
    settings: Settings | None = None,
    progress: Progress | None = None,
    scores: Sequence[Score | None] | None = None,
    halt: Halt | None = None,
) -> Joint:
    """Recover one scene, and the views and the path of each exposure, from several coded measurements of it.

    Args:
        shots: One or more, of one camera; their truths are not read. The first one's coordinates become those of all.
        settings: Of every stage. Things in the scene do not move in a reconstruction of several exposures.
        progress: Receives every stage and step.
        scores: Turn each one's views into a figure for the curve, in dB; they may know the truth.
        halt: A request to end early with the result so far; it can be made as soon as the fit has begun.

    Raises:
        InputError: The exposures are not of one camera, the settings let things move, or they name a CUDA device that
            cannot be used.
        ResourceError: The settings name a CUDA device that has too little memory.
        GeometryError: Nothing ties any two exposures to each other.
        NumericsError: The fit is not finite from its first iteration on.
    """
    settings, progress, halt = (settings or Settings()).check(), progress or Silent(), halt or Halt()
    check_alike(shots)
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
    for note in where_rendered.notes:
        progress.say(note.sentence)
    settings, clock = replace(settings, motion="off"), Stopwatch()
    tools = Tools.load(settings)
    with working_on(tools.backend.device):
        alone = list(observe_all(shots, settings, tools, progress, scores or [None] * len(shots)))
        observed, repeating = decoded_together(alone, settings, tools.geometry_prior, progress)
        where = places(observed)
        for note in (*where.left_out, *where.notes):
            progress.say(note.sentence)
        clock.lap("geometry")
        halt.begin()
        fits = _fitted(where.placed, settings, progress, halt, clock)
        clock.lap("fit")
        joint = _handed_over(where, fits, settings, progress, clock)
    notes = (*where_rendered.notes, *repeating, *joint.result.notes)
    return replace(joint, result=replace(joint.result, device=where_rendered.device, notes=notes))


def _fitted(
    placed: Sequence[PlacedExposure], settings: Settings, progress: Progress, halt: Halt, clock: Stopwatch
) -> tuple[CoarseFit, ...]:
    """Fit one scene to all exposures; return it as each of them sees it."""
    by_number = {one.of.number: one for one in placed}
    start = first_of_all(
        {number: one.start for number, one in by_number.items()},
        {number: one.geometry for number, one in by_number.items()},
    )
    run = CoarseRun(
        [one.to_fit() for one in placed],
        start.scene,
        shared_schedule(settings.fit, len(placed), start.growth),
        settings.seed,
        Monitoring(progress, clock.began_s, halt),
    )
    run.advance()
    return run.results()


def _handed_over(
    where: CommonPlaces, fits: Sequence[CoarseFit], settings: Settings, progress: Progress, clock: Stopwatch
) -> Joint:
    """Make the views of each exposure that are delivered, and the record of all."""
    placed, left_out = where.placed, where.left_out
    progress.stage("views", len(placed))
    given = _in_given_unit(placed, fits)
    parts = []
    for number, (one, fit) in enumerate(zip(placed, fits, strict=True)):
        parts.append(_part(one, fit, given[number], settings, clock))
        progress.step(number + 1)
    clock.lap("views")
    names = [one.of.name for one in placed]
    name = names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
    together = (finding(Code.EXPOSURES_TOGETHER, exposures=len(parts)),) if len(parts) > 1 else ()
    result = merged(
        parts,
        names,
        (*left_out, *where.notes, *together),
        {**clock.seconds(), "decode": sum(_seconds(one) for one in placed)},
    )
    if any(part.registered is not None for part in parts):
        # A camera matrix that was estimated is in the record, and belongs to no measurement.
        registered = [replace(one.of.shot, intrinsics=one.of.given.intrinsics) for one in placed]
        result = replace(result, registered=summed(registered, name))
    whole = summed([one.of.given for one in placed], name)
    return Joint(whole, result, given[0][1].scene, tuple(parts), left_out)


def _part(
    one: PlacedExposure, fit: CoarseFit, given: tuple[Geometry, CoarseFit], settings: Settings, clock: Stopwatch
) -> RunResult:
    """Return the record of one exposure.

    Args:
        one: The exposure.
        fit: The common scene as it sees it.
        given: Its path and the same fit in the unit of the given poses.
        settings: Of the reconstruction.
        clock: Of the whole.
    """
    observed, renderer = one.of.observed, one.renderer()
    first, fits = observed.first, observed.fits
    ensemble = Ensemble(fit, fit.views)
    recovered = hand_over(first, ensemble, fits.refine, fits.settings, ()).in_the_middle(ensemble, renderer)
    geometry, scaled = given
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
        sure = how_sure(first, geometry, raced.ensemble, recovered, renderer, light)
        left = replace(left, uncertainty=sure)
    clock.lap("fit")
    seconds = {"geometry": 0.0, "decode": 0.0, "fit": 0.0, **fits.clock.seconds()}
    return record(replace(settings, fits=1, seed=fits.settings.seed), left, fits.score, seconds)


def _in_given_unit(
    placed: Sequence[PlacedExposure], fits: Sequence[CoarseFit]
) -> tuple[tuple[Geometry, CoarseFit], ...]:
    """Return the first path and the fit of each exposure with lengths in the unit of the given poses, one for all."""
    before = np.concatenate([one.geometry.world_to_camera for one in placed])
    after = np.concatenate([fit.world_to_camera for fit in fits])
    best = replace(fits[0], world_to_camera=after)
    unit = next((one.geometry.unit for one in placed if one.geometry.unit is not None), None)
    every = replace(placed[0].geometry, world_to_camera=before, unit=unit)
    whole, ensemble = in_given_unit(every, Ensemble(best, best.views))
    scaled, found, at = ensemble.best, [], 0
    for one, fit in zip(placed, fits, strict=True):
        views = slice(at, at + len(fit.world_to_camera))
        # Lengths of the first path and its depth are those of the common coordinates, or of the given unit.
        depth = one.geometry.inverse_depth / (whole.unit or 1.0)
        geometry = replace(
            one.geometry,
            world_to_camera=whole.world_to_camera[views],
            inverse_depth=depth.astype(np.float32),
            unit=None if one.geometry.unit is None else whole.unit,
        )
        found.append((geometry, replace(fit, scene=scaled.scene, world_to_camera=scaled.world_to_camera[views])))
        at = views.stop
    return tuple(found)


def _seconds(one: PlacedExposure) -> float:
    return one.of.observed.fits.clock.seconds().get("decode", 0.0)


_STILL: Final = MotionReport("off")
