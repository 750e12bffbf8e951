"""From one coded measurement to views, camera path and Gaussian scene: the whole way on one page.

    registration ─► hold out some pixels ─► first look (decode, geometry, brightness) (─► near or far)
    ─► first Gaussians ─► coarse fits (─► second look ─► coarse fits) (─► fine fit) ─► their mean ─► residual
    ─► combine and judge by the held-out

Here: the order, the clock, and the judgement. Not here: any stage itself, its settings (`settings`), the record that is
handed over (`record`), files and metrics (`gs2ci.evaluate`).
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.errors import NumericsError
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.progress import Progress, Silent
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult, Verdict
from gs2ci.reconstruct.attempts import from_rest, needs_rest, ranking
from gs2ci.reconstruct.choices import FirstLookName
from gs2ci.reconstruct.decode.by_name import decode_by_name
from gs2ci.reconstruct.decode.coupling import choose_coupling
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.decode.patches.decoder import PatchSettings, patch_decode_from
from gs2ci.reconstruct.decode.residual import ResidualSettings
from gs2ci.reconstruct.first_look import FirstLook, look, look_closer
from gs2ci.reconstruct.fit.coarse import CoarseFit, fit_coarse
from gs2ci.reconstruct.fit.combination import combined as combined_views
from gs2ci.reconstruct.fit.combination import shares
from gs2ci.reconstruct.fit.ensemble import Ensemble, FitOne, Member, combined, fit_together, members
from gs2ci.reconstruct.fit.fine import Fine, fit_fine
from gs2ci.reconstruct.fit.looks import Score
from gs2ci.reconstruct.fit.metric import in_given_unit
from gs2ci.reconstruct.fit.motion import at_rest_until_moved, of_degree, set_moving
from gs2ci.reconstruct.fit.pace import Pace
from gs2ci.reconstruct.fit.refinement import Refinement
from gs2ci.reconstruct.fit.rendering import ShotRenderer
from gs2ci.reconstruct.fit.start import first_gaussians
from gs2ci.reconstruct.fit.withheld import Withheld, first_points, first_poses
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.prior import GeometryPrior
from gs2ci.reconstruct.measurement.dead_lines import close_dead_lines
from gs2ci.reconstruct.measurement.doubts import doubts_about, doubts_about_result
from gs2ci.reconstruct.measurement.holes import fill_holes
from gs2ci.reconstruct.measurement.hot_pixels import close_hot_pixels
from gs2ci.reconstruct.measurement.jury import Jury
from gs2ci.reconstruct.measurement.lens import Lens, straightened
from gs2ci.reconstruct.measurement.moving import LeftByMotion
from gs2ci.reconstruct.moving import (
    LEAST_GAIN,
    LEAST_PATCH_GAIN,
    MOVING,
    RELEASED,
    STILL,
    MotionReport,
    ask,
    released,
    rested,
    speaks_for_motion,
    speeds,
)
from gs2ci.reconstruct.one_thread import one_torch_thread
from gs2ci.reconstruct.order import LEAST_SCHEDULE, is_open, settle, shortened, unsettled
from gs2ci.reconstruct.record import Left, Recovered, record
from gs2ci.reconstruct.registration.register import register
from gs2ci.reconstruct.second_look import is_wanted, second_look
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.interface import Backend

# What is put back into a scene's views has to explain so much more, as a share of what they leave. In the dark a few
# thousandths are chance, and what was put back is noise: it cost up to 6 dB.
_LEAST_GAIN: Final = 0.01


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
    pace: Pace | None = None,
) -> Reconstruction:
    """Recover views, camera path and scene from one coded measurement.

    Args:
        shot: The measurement; its truth is not read.
        settings: Settings of every stage.
        progress: Told of every stage and step.
        score: Turns views, [N, H, W, C], into a figure for the curve, in dB; it may know the truth.
        pace: Decides how many iterations the fit has, instead of the settings.

    Returns:
        The best of three by the held-out pixels: the mean of the fits' views refined by its residual, the views of
        the best fit's scene, or the decode; and the other two.

    Raises:
        InputError: The shot's parts do not fit together, the settings make no sense, or poses are to come
            from telemetry that the shot does not hold.
        NumericsError: The first fit is not finite from its first iteration on.
    """
    settings, progress = settings or Settings(), progress or Silent()
    settings.check()
    lens = Lens.of(shot.check())
    tools = _Tools.load(settings)
    clock = _Stopwatch()
    registered = register(shot, settings.registration, progress, settings.seed)
    clock.lap("registration")
    sound, doubts = _examined(registered.shot, progress)
    jury = Jury.of(sound, settings.fit.hold_out.share, settings.seed)

    first = (look_closer if pace is None and settings.may_look_again else look)(
        jury, lens, tools.geometry_prior, settings.look, progress, clock.lap, registered.shot
    )
    jury, decoded = first.jury, first.decoded
    fitted = Jury(fill_holes(jury.shot, decoded), jury.heldout)
    refine = Refinement(jury, settings.residual)

    first = _settled(
        first, fitted, lens, settings, refine, progress, clock, hurried=pace is not None or not settings.try_orders
    )

    def attempt(look: FirstLook, views: F32, moving: bool) -> _Attempt:
        geometry, start = _beginning(look, views, lens, settings, moving=moving)
        clock.lap("geometry")
        fit_one = _fit_one(fitted, geometry, lens, settings, refine, score, clock)
        team = members(start, settings.density_rules, settings.fits, settings.seed)
        team = tuple(replace(one, start=of_degree(one.start, number)) for number, one in enumerate(team))
        fits = fit_together(fit_one, team, progress, pace)
        ensemble = combined(fits, jury, refine)
        clock.lap("fit")
        return _Attempt(look, geometry, fits, ensemble)

    def release(still: _Attempt) -> _Attempt:
        freed = replace(settings, fit=released(settings.fit))
        team, paths = [], {}
        for number, fit in enumerate(still.fits):
            start = of_degree(at_rest_until_moved(fit.scene, freed.fit.motion), number)
            team.append(Member(start, freed.fit.density, number))
            paths[number] = replace(still.geometry, world_to_camera=fit.world_to_camera)

        def fit_one(member: Member, progress: Progress, pace: Pace | None) -> CoarseFit:
            return _fit_one(fitted, paths[member.seed], lens, freed, refine, score, clock)(member, progress, pace)

        fits = fit_together(fit_one, tuple(team), progress, None)
        ensemble = combined(fits, jury, refine)
        clock.lap("fit")
        return replace(still, fits=fits, ensemble=ensemble)

    trials = _Trials(attempt, release, jury, lens, settings, refine, progress)
    tried, motion = trials.hurried(first) if pace is not None else trials.all(first)
    geometry, ensemble = tried.geometry, tried.ensemble
    renderer = ShotRenderer(fitted.shot, geometry.intrinsics, tools.backend, lens)
    if tools.fine is not None and ensemble.best.scene.motion is None:
        best = ensemble.best
        detailed = Refinement(jury, settings.residual or ResidualSettings()).in_full
        fined = fit_fine(
            fitted, best, renderer, tools.fine, settings.seed, refine.in_full, progress, score, clock.began_s, detailed
        )
        ensemble = combined(tuple(fined if fit is best else fit for fit in tried.fits), jury, refine)
        clock.lap("fine")
    recovered = _recover(first, ensemble, refine, settings, polish=motion.tried)
    geometry, ensemble = in_given_unit(geometry, ensemble)
    light = renderer.stopped_light(ensemble.best.scene, ensemble.best.world_to_camera)
    seen = speeds(renderer, ensemble.best.scene, ensemble.best.world_to_camera)
    clock.lap("fit")
    left = Left(registered, doubts, tried.look, geometry, ensemble, light, recovered, motion, seen)
    return Reconstruction(record(settings, left, score, clock.seconds()), ensemble.best.scene)


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


@dataclass(frozen=True)
class _Attempt:
    """Fits, and the look and the geometry that they began with."""

    look: FirstLook
    geometry: Geometry
    fits: tuple[CoarseFit, ...]
    ensemble: Ensemble


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

    # By the measurement alone: views of either order show surfaces that bear it out.
    brief = replace(settings, fit=replace(shortened(settings.fit), surfaces=None))
    begun: dict[int, tuple[Geometry, tuple[Geometry, Gaussians]]] = {}

    def leaves(began: Geometry, number: int) -> float:
        if id(began) not in begun:
            # The geometry is kept beside, so that no other one gets its number.
            begun[id(began)] = began, _beginning(replace(first, geometry=began), first.decoded, lens, brief)
        at, start = begun[id(began)][1]
        member = members(start, brief.density_rules[:1], number + 1, settings.seed)[number]
        try:
            fit = _fit_one(jury, at, lens, brief, refine, None, clock)(member, Silent(), None)
        except NumericsError:
            return math.inf
        return _left(jury, fit.views)

    told = geometry.source not in ("tracks", "wide", "uniform")
    if not hurried and settings.fit.iterations >= LEAST_SCHEDULE:
        geometry = settle(geometry, leaves, progress, told=told)
    elif not told:
        geometry = unsettled(geometry)
    for note in geometry.notes:
        if note not in first.geometry.notes:
            progress.say(note.sentence)
    clock.lap("fit")
    return replace(first, geometry=geometry)


def _left(jury: Jury, views: F32) -> float:
    """Return the mean square that views, [N, H, W, C], leave of the readings that can be trusted."""
    asked = jury.shot.lit
    if jury.shot.saturated is not None:
        asked &= ~jury.shot.saturated
    residual = (jury.coded(views) - jury.shot.measurement)[asked].astype(np.float64)
    return float(np.mean(residual**2)) if residual.size else 0.0


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
        )

    return fit


@dataclass(frozen=True)
class _Trials:
    """What is fitted to a measurement, from the first look and from what else is worth it, until one is taken.

    Args:
        attempt: Fits from a look, with views to take colours and motion from, a scene that is still or may move.
        release: Goes on with fits of a still scene, and lets it move.
        jury: The measurement.
        lens: Through which it was taken, unless it is a pinhole.
        settings: What may be tried.
        refine: What will be done to the views of fits.
        progress: Told why more is tried.
    """

    attempt: Callable[[FirstLook, F32, bool], _Attempt]
    release: Callable[[_Attempt], _Attempt]
    jury: Jury
    lens: Lens | None
    settings: Settings
    refine: Refinement
    progress: Progress

    def hurried(self, first: FirstLook) -> tuple[_Attempt, MotionReport]:
        """Make one attempt, whatever comes of it."""
        moving = self.settings.motion == "on"
        tried = self.attempt(rested(first) if moving else first, first.decoded, moving)
        name = MOVING if moving else STILL
        return tried, self._report(None, {name: tried}, tried, {})

    def all(self, first: FirstLook) -> tuple[_Attempt, MotionReport]:
        """Make those that are worth it; return the best, and how anything in it came to move, or not to."""
        still = self._still(first)
        wanted = self.settings.motion == "on"
        # Fits that were cut short leave much that patches explain, whether or not anything moves.
        whole = self.settings.fit.iterations >= LEAST_SCHEDULE
        if not (wanted or (self.settings.may_move and whole)):
            return still, self._report(None, {STILL: still}, still, {})
        left = ask(self.jury, still.ensemble.views)
        attempts = {STILL: still}
        refined = self.refine(still.ensemble.views) if wanted or speaks_for_motion(left) else None
        if refined is not None and (wanted or self._gains(refined)):
            self.progress.say("What the still scene leaves looks like motion: scenes that move are fitted as well.")
            views = min((refined, first.decoded), key=lambda shown: self.jury.residual_rms(shown) or 0.0)
            attempts[RELEASED] = self.release(still)
            attempts[MOVING] = self.attempt(rested(still.look), views, True)
        residuals = self._residuals(attempts) if len(attempts) > 1 else {}
        tried = self._clearly_best(attempts, residuals) if residuals else still
        return tried, self._report(left, attempts, tried, residuals)

    def _still(self, first: FirstLook) -> _Attempt:
        """Fit a still scene; once more from a second look, or from rest, where the first path is doubtful."""
        tried = self.attempt(first, first.decoded, False)
        if not self.settings.may_look_again or not is_wanted(first.geometry, self.settings.geometry):
            return tried
        views = self.refine(tried.ensemble.views)
        attempts = {first.geometry.source: tried}
        again = second_look(first, views, self.lens, self.settings.look, self.progress)
        if again is not None:
            attempts["second look"] = self.attempt(again, views, False)
        if needs_rest(first):
            attempts["rest"] = self.attempt(from_rest(first), first.decoded, False)
        return self._best(attempts, self._residuals(attempts))

    def _gains(self, refined: F32) -> bool:
        """Tell whether a few steps of a decode by similar patches, which may move, predict held-out pixels better."""
        polished = patch_decode_from(self.jury.seen, refined, PatchSettings.from_scene_briefly())
        before, after = self.jury.residual_rms(refined), self.jury.residual_rms(polished)
        return before is not None and after is not None and after < (1 - LEAST_PATCH_GAIN) * before

    def _best(self, attempts: dict[str, _Attempt], residuals: dict[str, float | None]) -> _Attempt:
        """Choose the attempt that predicts the held-out pixels best, and say how all of them did."""
        tried = attempts[min(attempts, key=lambda name: math.inf if (rms := residuals[name]) is None else rms)]
        notes = ranking({name: residuals[name] for name in attempts})
        return replace(tried, geometry=replace(tried.geometry, notes=(*tried.geometry.notes, *notes)))

    def _clearly_best(self, attempts: dict[str, _Attempt], residuals: dict[str, float | None]) -> _Attempt:
        """Choose likewise, but a scene that moves only if it predicts them clearly better than the still one."""
        if self.settings.motion == "on":
            return self._best({name: tried for name, tried in attempts.items() if name != STILL}, residuals)
        best, still = self._best(attempts, residuals), attempts[STILL]
        if best.ensemble is still.ensemble:
            return best
        moves, stays = residuals[_name_of(best, attempts)], residuals[STILL]
        better = moves is not None and stays is not None and moves < (1 - LEAST_GAIN) * stays
        return best if better else still

    def _residuals(self, attempts: dict[str, _Attempt]) -> dict[str, float | None]:
        """Return what each attempt's refined views leave of the held-out pixels."""
        return {name: self.jury.residual_rms(self.refine(tried.ensemble.views)) for name, tried in attempts.items()}

    def _report(
        self,
        left: LeftByMotion | None,
        attempts: dict[str, _Attempt],
        taken: _Attempt,
        residuals: dict[str, float | None],
    ) -> MotionReport:
        moves = taken.ensemble.best.scene.motion is not None
        return MotionReport(
            self.settings.motion, left, tuple(residuals.items()), _name_of(taken, attempts), moves=moves
        )


def _name_of(taken: _Attempt, attempts: dict[str, _Attempt]) -> str:
    return next(name for name, tried in attempts.items() if tried.ensemble is taken.ensemble)


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


def _recover(
    first: FirstLook, ensemble: Ensemble, refine: Refinement, settings: Settings, *, polish: bool
) -> Recovered:
    """Let the held-out pixels choose between the refined views, the best scene's and the decode.

    Where the settings put no residual back, nothing chooses: they are the best scene's.

    Refined are the fits' mean views with their residual put back, combined with the scene's and the decode's where
    these pixels ask for it. What is chosen is taken again from all pixels, a decode by GAP-TV with its views coupled
    as they recommend. Where things move no scene of ours says all, and a decode by similar patches goes on from the
    refined views, if held-out pixels bear it out (`polish`).
    """
    jury, decoded = first.jury, first.decoded
    if settings.residual is None:
        own = ensemble.best.views
        candidates: dict[Verdict, F32] = {"refined": own, "scene": own, "decode": decoded}
        judged = {name: jury.residual_rms(views) for name, views in candidates.items()}
        notes = doubts_about_result(jury, own) if jury.heldout.any() else (finding(Code.UNJUDGED),)
        return Recovered(own, "scene", judged, notes)
    refined, share = refine.with_share(ensemble.views)
    polishing, before, after = PatchSettings.from_scene(), jury.residual_rms(refined), None
    if polish:
        polished = patch_decode_from(jury.seen, refined, polishing)
        after = jury.residual_rms(polished)
        polish = before is not None and after is not None and after < before
        refined = polished if polish else refined
    parts: dict[Verdict, F32] = {"refined": refined, "scene": ensemble.best.views, "decode": decoded}
    wanted = shares(jury, parts)
    candidates = {**parts, "refined": combined_views(parts, wanted)}
    heldout_rms = {name: jury.residual_rms(views) for name, views in candidates.items()}
    verdict = _judge(heldout_rms)
    notes = doubts_about_result(jury, candidates[verdict]) if jury.heldout.any() else (finding(Code.UNJUDGED),)
    # The pixels that judged may now help as well.
    decode_share = {"decode": 1.0, "scene": 0.0, "refined": wanted["decode"]}[verdict]
    if decode_share > 0:
        parts["decode"] = _decoded_again(jury.shot, first.decoder, settings)
    if verdict != "refined":
        return Recovered(parts[verdict], verdict, heldout_rms, notes)
    parts["refined"] = refine.by_all_pixels(ensemble.views, share)
    if polish:
        parts["refined"] = patch_decode_from(jury.shot, parts["refined"], polishing)
        notes = (*notes, finding(Code.VIEWS_POLISHED, before=before or 0.0, after=after or 0.0))
    if wanted["refined"] < 1:
        mixed = finding(Code.VIEWS_COMBINED, refined=wanted["refined"], scene=wanted["scene"], decode=wanted["decode"])
        notes = (*notes, mixed)
    return Recovered(combined_views(parts, wanted), verdict, heldout_rms, notes)


def _decoded_again(shot: Shot, decoder: FirstLookName, settings: Settings) -> F32:
    """Decode all pixels, by GAP-TV with its views coupled as held-out pixels recommend, or by patches."""
    if decoder != "gap-tv":
        return decode_by_name(shot, "patches", settings.decode)
    return gap_tv(shot, choose_coupling(shot, settings.decode, settings.seed))


def _judge(heldout_rms: dict[Verdict, float | None]) -> Verdict:
    """Name the candidate with the smallest held-out residual; without any held-out pixels, the scene itself.

    Refined views that hardly explain more than the scene's, or than the decode's, are not among them: they are combined
    of these, and by chance alone no worse.
    """
    known = {name: rms for name, rms in heldout_rms.items() if rms is not None}
    if not known:
        return "scene"
    if known["refined"] > (1 - _LEAST_GAIN) * min(known["scene"], known["decode"]):
        del known["refined"]
    return min(known, key=lambda name: known[name])
