"""From one coded measurement to views, camera path and Gaussian scene: the whole reconstruction on one page.

    registration ─► hold out some pixels ─► first look (decode, geometry, brightness) (─► nothing tracked: longer
    decode, geometry) (─► order of depth) ─► first Gaussians ─► coarse fits (─► second look ─► coarse fits)
    (─► fine fit) ─► their mean ─► residual ─► combine and judge by the held-out pixels

Here: the order of the stages and their timing. Not here: any stage itself, which attempts are made and chosen
(`attempts`), `settings`, the views handed over (`handing_over`), their record (`record`), files and metrics
(`gs2ci.evaluate`).
"""

from dataclasses import dataclass, replace

import numpy as np

from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.halt import Halt
from gs2ci.core.progress import Progress, Silent
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult
from gs2ci.reconstruct.attempts.choice import Attempts
from gs2ci.reconstruct.attempts.fits import Fits
from gs2ci.reconstruct.choices import LeftOut
from gs2ci.reconstruct.far_apart import joins_in_part, look_far_apart
from gs2ci.reconstruct.first_look import FirstLook, look, look_closer, needs_rest
from gs2ci.reconstruct.fit.fine import Fine
from gs2ci.reconstruct.fit.looks import Score
from gs2ci.reconstruct.fit.mask_moments import MaskMoments, needed
from gs2ci.reconstruct.fit.metric import in_given_unit
from gs2ci.reconstruct.fit.one_thread import one_torch_thread
from gs2ci.reconstruct.fit.refinement import Refinement
from gs2ci.reconstruct.fit.rendering import ShotRenderer
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.geometry.prior import GeometryPrior
from gs2ci.reconstruct.handing_over import hand_over
from gs2ci.reconstruct.measurement.brightness import Brightness
from gs2ci.reconstruct.measurement.doubts import doubts_about
from gs2ci.reconstruct.measurement.faulty import close_faulty_pixels
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.measurement.holes import fill_holes
from gs2ci.reconstruct.measurement.lens import Lens, straightened
from gs2ci.reconstruct.moving import speeds
from gs2ci.reconstruct.presets.budget import Budget
from gs2ci.reconstruct.record import Left, record
from gs2ci.reconstruct.registration.register import Registered, register
from gs2ci.reconstruct.settings import Settings
from gs2ci.reconstruct.stopwatch import Stopwatch
from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.interface import Backend


@dataclass(frozen=True)
class Reconstruction:
    """The result: the record of the run, and the Gaussians."""

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
    registered: Registered | None = None,
) -> Reconstruction:
    """Recover views, camera path and scene from one coded measurement.

    Args:
        shot: The measurement; its truth is not read.
        settings: Settings of every stage.
        progress: Receives every stage and step.
        score: Turns views, [N, H, W, C], into a figure for the curve, in dB; it may know the truth.
        budget: Decides how much is fitted, instead of the settings.
        halt: A request to end early. When it is made, the running fit stops, no further fit is started, and the result
            so far is returned with a finding that says so. It can be made as soon as the fit has begun.
        registered: The registration, if `shot` is its corrected measurement already; it is not registered again.

    Returns:
        The combination of three sets of views with the smallest error expected from the held-out pixels: the mean of
        the fits' views refined by its residual, the views of the best fit's scene, and the decode; and the latter two.

    Raises:
        InputError: The shot's parts do not fit together, the settings make no sense, or poses are to come
            from telemetry that the shot does not hold; or the budget does not suffice.
        NumericsError: The first fit is not finite from its first iteration on.
    """
    settings, progress, halt = settings or Settings(), progress or Silent(), halt or Halt()
    settings.check()
    lens = Lens.of(shot.check())
    settings = replace(settings, mask_moments=settings.mask_moments.of(shot))
    tools, clock = _Tools.load(settings), Stopwatch()
    registered = registered or register(shot, settings.registration, progress, settings.seed)
    clock.lap("registration")
    sound, doubts = _examined(registered.shot, progress)
    holdout = Holdout.of(sound, settings.fit.hold_out.share, settings.seed, registered.averaged)

    again = budget is None and settings.may_look_again
    first = (look_closer if again else look)(
        holdout, lens, tools.geometry_prior, settings, progress, clock.lap, registered.shot
    )
    partly = joins_in_part(first)
    if (
        again
        and LeftOut.MATCHES_IN_A_LONGER_DECODE not in settings.left_out
        and (partly or (settings.poses == "auto" and needs_rest(first)))
    ):
        # A motion without tracks explains the measurement so far that weights corrected along it are better than those
        # given.
        weighted = holdout if partly else first.holdout
        first = look_far_apart(first, weighted, lens, settings, progress, clock.lap) or first
    holdout = first.holdout
    fits = Fits(
        holdout=holdout,
        fitted=Holdout(fill_holes(holdout.shot, first.decoded), holdout.pixels),
        lens=lens,
        settings=settings,
        refine=Refinement(holdout, settings.residual),
        progress=progress,
        clock=clock,
        score=_as_shown(score, first.brightness),
        halt=halt,
    )
    first = fits.settle_order(first, hurried=budget is not None)
    mask_moments = _mask_moments(first, lens, settings, progress)
    halt.begin()
    fits = replace(fits, mask_moments=mask_moments).within(budget, first)
    settings, refine = fits.settings, fits.refine

    attempts = Attempts(fits)
    first, tried, motion = attempts.hurried(first) if budget is not None else attempts.all(first)
    geometry, ensemble = tried.geometry, tried.ensemble
    renderer = ShotRenderer(fits.fitted.shot, geometry.intrinsics, tools.backend, lens, mask_moments)
    if tools.fine is not None and ensemble.best.scene.motion is None and not halt.asked:
        ensemble = fits.fine(tried, renderer, tools.fine)
    progress.stage("views")
    hurried = budget is not None
    recovered = hand_over(first, ensemble, refine, settings, motion.polishing, hurried=hurried)
    recovered = recovered.in_the_middle(ensemble, renderer)
    geometry, ensemble = in_given_unit(geometry, ensemble)
    light = renderer.stopped_light(ensemble.best.scene, ensemble.best.world_to_camera)
    seen = speeds(renderer, ensemble.best.scene, ensemble.best.world_to_camera)
    clock.lap("fit")
    left = Left(
        registered,
        (*doubts, *_said_if_halted(halt, progress)),
        tried.look.with_decode_of(first),
        geometry,
        ensemble,
        light,
        recovered,
        motion,
        seen,
        mask_moments,
    )
    return Reconstruction(record(settings, left, fits.score, clock.seconds()), ensemble.best.scene)


@dataclass(frozen=True)
class _Tools:
    """The parts that the settings name, loaded first, so that a wrong name is refused before any work is done."""

    backend: Backend
    fine: Fine | None
    geometry_prior: GeometryPrior

    @classmethod
    def load(cls, settings: Settings) -> "_Tools":
        backend = load_backend(settings.backend, settings.raster)
        fine = None if settings.fine is None else Fine.load(settings.fine, settings.fit.loss, settings.seed)
        return cls(backend, fine, load_geometry_prior(settings.poses))


def _as_shown(score: Score | None, light: Brightness) -> Score | None:
    """Return a score that gives evenly lit views the brightness of the delivered ones before it judges them."""
    return None if score is None else lambda views: score(light.shown(views))


def _said_if_halted(halt: Halt, progress: Progress) -> tuple[Finding, ...]:
    """Return, and report, a finding that the rest was skipped, if an early end was requested."""
    if not halt.asked:
        return ()
    note = finding(Code.INTERRUPTED)
    progress.say(note.sentence)
    return (note,)


def _examined(shot: Shot, progress: Progress) -> tuple[Shot, tuple[Finding, ...]]:
    """Return the shot with dead lines and hot pixels closed (their masks set to zero), and the doubts about it."""
    sound, faulty = close_faulty_pixels(shot)
    doubts = (*doubts_about(shot), *faulty)
    for doubt in doubts:
        progress.say(doubt.sentence)
    return sound, doubts


def _mask_moments(first: FirstLook, lens: Lens | None, settings: Settings, progress: Progress) -> MaskMoments | None:
    """Return the moments within each mask that the first path requires, and report them; None if one is enough."""
    views, open_share = straightened(first.decoded, lens), np.clip(first.weights_given, 0, 1)
    found = needed(first.geometry, views, open_share, settings.mask_moments)
    if found is not None:
        progress.say(found.note.sentence)
    return found
