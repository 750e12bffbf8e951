"""From one coded measurement to views, camera path and Gaussian scene: the whole way on one page.

    registration ─► hold out some pixels ─► first look (decode, geometry, brightness) (─► near or far)
    ─► first Gaussians ─► coarse fits (─► second look ─► coarse fits) (─► fine fit) ─► their mean ─► residual
    ─► combine and judge by the held-out

Here: the order and the clock. Not here: any stage, which attempts are made and taken (`attempts`), `settings`,
the views handed over (`handing_over`), their record (`record`), files and metrics (`gs2ci.evaluate`).
"""

import time
from dataclasses import dataclass, replace
from typing import Final

from gs2ci.core.arrays import F32, F64
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.halt import Halt
from gs2ci.core.progress import Progress, Silent
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult
from gs2ci.reconstruct.attempts.choice import Attempt, Attempts
from gs2ci.reconstruct.attempts.order import LEAST_SCHEDULE, is_open, settle, unsettled
from gs2ci.reconstruct.attempts.order_fits import OrderFits
from gs2ci.reconstruct.decode.residual import ResidualSettings
from gs2ci.reconstruct.first_look import FirstLook, look, look_closer
from gs2ci.reconstruct.fit.coarse import CoarseFit, CoarseSettings, fit_coarse
from gs2ci.reconstruct.fit.ensemble import Ensemble, FitOne, Member, combined, fit_together, members
from gs2ci.reconstruct.fit.fine import Fine, fit_fine
from gs2ci.reconstruct.fit.looks import Score
from gs2ci.reconstruct.fit.metric import in_given_unit
from gs2ci.reconstruct.fit.motion import at_rest_until_moved, of_degree, set_moving
from gs2ci.reconstruct.fit.one_thread import one_torch_thread
from gs2ci.reconstruct.fit.pace import Pace, Timed
from gs2ci.reconstruct.fit.refinement import Refinement
from gs2ci.reconstruct.fit.rendering import ShotRenderer
from gs2ci.reconstruct.fit.start import first_gaussians
from gs2ci.reconstruct.fit.withheld import Withheld, first_points, first_poses
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.prior import GeometryPrior
from gs2ci.reconstruct.handing_over import hand_over
from gs2ci.reconstruct.measurement.brightness import Brightness
from gs2ci.reconstruct.measurement.dead_lines import close_dead_lines
from gs2ci.reconstruct.measurement.doubts import doubts_about
from gs2ci.reconstruct.measurement.holes import fill_holes
from gs2ci.reconstruct.measurement.hot_pixels import close_hot_pixels
from gs2ci.reconstruct.measurement.jury import Jury
from gs2ci.reconstruct.measurement.lens import Lens, straightened
from gs2ci.reconstruct.moving import released, speeds
from gs2ci.reconstruct.presets.budget import Budget
from gs2ci.reconstruct.record import Left, record
from gs2ci.reconstruct.registration.register import register
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.interface import Backend

# By so many iterations, and a look, the fits that fit into a budget are chosen.
_TIMED_ITERATIONS: Final = 6


@dataclass(frozen=True)
class Reconstruction:
    """What was recovered: the record of the run, and the Gaussians."""

    result: RunResult
    scene: Gaussians


@one_torch_thread()
def reconstruct(
    shot: Shot,
    settings: Settings | None = None,
    progress: Progress | None = None,
    score: Score | None = None,
    budget: Budget | None = None,
    halt: Halt | None = None,
) -> Reconstruction:
    """Recover views, camera path and scene from one coded measurement.

    Args:
        shot: The measurement; its truth is not read.
        settings: Settings of every stage.
        progress: Told of every stage and step.
        score: Turns views, [N, H, W, C], into a figure for the curve, in dB; it may know the truth.
        budget: Decides how much is fitted, instead of the settings.
        halt: When it is asked, the fit ends where it is, nothing more is tried, and what there is gets handed over
            with a finding that says so. It can be asked as soon as the fit has begun.

    Returns:
        The combination that is expected to err least, by the held-out pixels: of the mean of the fits' views refined by
        its residual, the views of the best fit's scene, and the decode; and the latter two.

    Raises:
        InputError: The shot's parts do not fit together, the settings make no sense, or poses are to come
            from telemetry that the shot does not hold; or the budget does not suffice.
        NumericsError: The first fit is not finite from its first iteration on.
    """
    settings, progress, halt = settings or Settings(), progress or Silent(), halt or Halt()
    settings.check()
    lens = Lens.of(shot.check())
    tools, clock = _Tools.load(settings), _Stopwatch()
    registered = register(shot, settings.registration, progress, settings.seed)
    clock.lap("registration")
    sound, doubts = _examined(registered.shot, progress)
    jury = Jury.of(sound, settings.fit.hold_out.share, settings.seed)

    first = (look_closer if budget is None and settings.may_look_again else look)(
        jury, lens, tools.geometry_prior, settings, progress, clock.lap, registered.shot
    )
    jury, decoded = first.jury, first.decoded
    score = _as_shown(score, first.brightness)
    fitted = Jury(fill_holes(jury.shot, decoded), jury.heldout)
    refine = Refinement(jury, settings.residual)

    first = _settled(
        first, fitted, lens, settings, refine, progress, clock, hurried=budget is not None or not settings.try_orders
    )
    halt.begin()
    settings, pace = _affordable(budget, settings, first, fitted, lens, refine, progress, clock)

    def attempt(look: FirstLook, views: F32, moving: bool) -> Attempt:
        geometry, start = _beginning(look, views, lens, settings, moving=moving)
        clock.lap("geometry")
        fit_one = _fit_one(fitted, geometry, lens, settings, refine, score, clock, halt)
        team = members(start, settings.density_rules, settings.fits, settings.seed)
        team = tuple(replace(one, start=of_degree(one.start, number)) for number, one in enumerate(team))
        fits = fit_together(fit_one, team, progress, pace, halt)
        ensemble = combined(fits, jury, refine)
        clock.lap("fit")
        return Attempt(look, geometry, fits, ensemble)

    def release(still: Attempt) -> Attempt:
        freed = replace(settings, fit=released(settings.fit))
        team, paths = [], {}
        for number, fit in enumerate(still.fits):
            start = of_degree(at_rest_until_moved(fit.scene, freed.fit.motion), number)
            team.append(Member(start, freed.fit.density, number))
            paths[number] = replace(still.geometry, world_to_camera=fit.world_to_camera)

        def fit_one(member: Member, progress: Progress, pace: Pace | None) -> CoarseFit:
            fit = _fit_one(fitted, paths[member.seed], lens, freed, refine, score, clock, halt)
            return fit(member, progress, pace)

        fits = fit_together(fit_one, tuple(team), progress, None, halt)
        ensemble = combined(fits, jury, refine)
        clock.lap("fit")
        return replace(still, fits=fits, ensemble=ensemble)

    attempts = Attempts(attempt, release, jury, lens, settings, refine, progress, clock.lap, halt)
    first, tried, motion = attempts.hurried(first) if budget is not None else attempts.all(first)
    geometry, ensemble = tried.geometry, tried.ensemble
    renderer = ShotRenderer(fitted.shot, geometry.intrinsics, tools.backend, lens)
    if tools.fine is not None and ensemble.best.scene.motion is None and not halt.asked:
        ensemble = _fined(tried, fitted, jury, renderer, tools.fine, settings, refine, progress, score, clock, halt)
    doubts = (*doubts, *_said_if_halted(halt, progress))
    recovered = hand_over(first, ensemble, refine, settings, motion.polishing)
    geometry, ensemble = in_given_unit(geometry, ensemble)
    light = renderer.stopped_light(ensemble.best.scene, ensemble.best.world_to_camera)
    seen = speeds(renderer, ensemble.best.scene, ensemble.best.world_to_camera)
    clock.lap("fit")
    left = Left(
        registered, doubts, tried.look.with_decode_of(first), geometry, ensemble, light, recovered, motion, seen
    )
    return Reconstruction(record(settings, left, score, clock.seconds()), ensemble.best.scene)


def _affordable(
    budget: Budget | None,
    settings: Settings,
    first: FirstLook,
    jury: Jury,
    lens: Lens | None,
    refine: Refinement,
    progress: Progress,
    clock: "_Stopwatch",
) -> tuple[Settings, Pace | None]:
    """Return the settings of fits for which a budget suffices, by a few timed iterations, and the pace that they keep.

    Without a budget: the settings, and no pace.
    """
    if budget is None:
        return settings, None
    brief = replace(
        settings.fit,
        iterations=_TIMED_ITERATIONS,
        densify_from=1.0,
        surfaces=None,
        hold_out=settings.fit.hold_out.looking(_TIMED_ITERATIONS),
    )
    geometry, start = _beginning(first, first.decoded, lens, settings)
    fit = _fit_one(jury, geometry, lens, replace(settings, fit=brief), refine, None, clock)
    timed = Timed(_TIMED_ITERATIONS)
    fit(Member(start, settings.fit.density, settings.seed), Silent(), timed)
    settings, pace, said = budget.fit(settings, timed)
    progress.say(said)
    clock.lap("fit")
    return settings, pace


@dataclass(frozen=True)
class _Tools:
    """What the settings name, loaded before any time is spent on the measurement."""

    backend: Backend
    fine: Fine | None
    geometry_prior: GeometryPrior

    @classmethod
    def load(cls, settings: Settings) -> "_Tools":
        backend = load_backend(settings.backend, settings.raster)
        fine = None if settings.fine is None else Fine.load(settings.fine, settings.fit.loss, settings.seed)
        return cls(backend, fine, load_geometry_prior(settings.poses))


def _settled(
    first: FirstLook,
    jury: Jury,
    lens: Lens | None,
    settings: Settings,
    refine: Refinement,
    progress: Progress,
    clock: "_Stopwatch",
    *,
    hurried: bool,
) -> FirstLook:
    """Settle the order of depth by short fits where the first look leaves it open; with a doubt where hurried.

    A path that a stage told is not asked about; one from a file has a sign of its own, and needs no doubt.
    """
    geometry, criteria = first.geometry, settings.geometry.criteria
    if settings.withheld != Withheld() or not is_open(geometry, criteria):
        return first

    def begin(began: Geometry) -> tuple[Geometry, Gaussians]:
        return _beginning(replace(first, geometry=began), first.decoded, lens, settings)

    def fit_one(at: Geometry, how: CoarseSettings) -> FitOne:
        return _fit_one(jury, at, lens, replace(settings, fit=how), refine, None, clock)

    def depths(at: Geometry, scene: Gaussians, poses: F64) -> F32:
        backend = load_backend(settings.backend, settings.raster)
        return ShotRenderer(jury.shot, at.intrinsics, backend, lens).depths(scene, poses)

    fits = OrderFits(jury, settings, begin, fit_one, depths)
    told = geometry.source not in ("tracks", "wide", "uniform")
    if not hurried and settings.fit.iterations >= LEAST_SCHEDULE:
        geometry = settle(geometry, fits.brief, fits.finish, progress, told=told)
    elif not told:
        geometry = unsettled(geometry)
    for note in geometry.notes:
        if note not in first.geometry.notes:
            progress.say(note.sentence)
    clock.lap("fit")
    return replace(first, geometry=geometry)


def _as_shown(score: Score | None, light: Brightness) -> Score | None:
    """Return a score of views of even light that judges them as bright as they will be handed over."""
    return None if score is None else lambda views: score(light.shown(views))


def _said_if_halted(halt: Halt, progress: Progress) -> tuple[Finding, ...]:
    """Return, and say, that the rest was left out, where somebody asked for the result as it was."""
    if not halt.asked:
        return ()
    note = finding(Code.INTERRUPTED)
    progress.say(note.sentence)
    return (note,)


def _examined(shot: Shot, progress: Progress) -> tuple[Shot, tuple[Finding, ...]]:
    """Return the shot with its dead lines and hot pixels closed, and what is to be doubted about it."""
    alive, dead = close_dead_lines(shot)
    sound, hot = close_hot_pixels(alive)
    doubts = (*doubts_about(shot), *dead, *hot)
    for doubt in doubts:
        progress.say(doubt.sentence)
    return sound, doubts


def _beginning(
    look: FirstLook, views: F32, lens: Lens | None, settings: Settings, *, moving: bool = False
) -> tuple[Geometry, Gaussians]:
    """Return poses, and the Gaussians to start from, as far as the settings do not withhold them.

    Args:
        look: What was found.
        views: They give the Gaussians their colours, [N, H, W, C].
        lens: The shot's.
        settings: What is withheld, and how far apart the Gaussians begin.
        moving: Whether they begin with the motion that the views show.
    """
    geometry, views = first_poses(look.geometry, settings.withheld), straightened(views, lens)
    start = first_gaussians(first_points(geometry, views, settings.stride_px, settings.withheld, settings.seed))
    if moving:
        start = set_moving(start, geometry, views, settings.fit.motion)
    # What is fitted and handed over counts the sensor's pixels, and no longer the canvas's.
    return (geometry if lens is None else replace(geometry, intrinsics=lens.intrinsics)), start


def _fit_one(
    jury: Jury,
    geometry: Geometry,
    lens: Lens | None,
    settings: Settings,
    refine: Refinement,
    score: Score | None,
    clock: "_Stopwatch",
    halt: Halt | None = None,
) -> FitOne:
    """Say how one fit of the ensemble goes."""

    def fit(member: Member, progress: Progress, pace: Pace | None) -> CoarseFit:
        return fit_coarse(
            jury=jury,
            start=member.start,
            geometry=geometry,
            backend=load_backend(settings.backend, settings.raster),  # its buffers serve one at a time
            settings=replace(settings.fit, density=member.density),
            seed=member.seed,
            refine=refine.in_full,
            progress=progress,
            score=score,
            since_s=clock.began_s,
            pace=pace,
            lens=lens,
            halt=halt,
        )

    return fit


def _fined(
    tried: Attempt,
    fitted: Jury,
    jury: Jury,
    renderer: ShotRenderer,
    fine: Fine,
    settings: Settings,
    refine: Refinement,
    progress: Progress,
    score: Score | None,
    clock: "_Stopwatch",
    halt: Halt,
) -> Ensemble:
    """Take the best of an attempt's fits through the fine stage."""
    best = tried.ensemble.best
    detailed = Refinement(jury, settings.residual or ResidualSettings()).in_full
    fined = fit_fine(
        fitted, best, renderer, fine, settings.seed, refine.in_full, progress, score, clock.began_s, detailed, halt
    )
    ensemble = combined(tuple(fined if fit is best else fit for fit in tried.fits), jury, refine)
    clock.lap("fine")
    return ensemble


class _Stopwatch:
    """Wall-clock seconds by stage."""

    def __init__(self) -> None:
        self.began_s = self._lap_s = time.monotonic()
        self._stages: dict[str, float] = {}

    def lap(self, stage: str) -> None:
        now = time.monotonic()
        self._stages[stage] = self._stages.get(stage, 0.0) + now - self._lap_s
        self._lap_s = now

    def seconds(self) -> dict[str, float]:
        return {**self._stages, "total": self._lap_s - self.began_s}
