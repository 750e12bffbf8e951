"""From one coded measurement to views, camera path and Gaussian scene: the whole reconstruction on one page.

    observe ─► propose ─► race ─► fuse ─► report

Here: the order of the stages and their timing. Not here: any stage itself: the masks' `registration`, the `first_look`
(decode, geometry, brightness), the `hypotheses` and their fits, the views delivered (`fusion`), their `record`.
"""

from dataclasses import dataclass

from gs2ci.core.halt import Halt
from gs2ci.core.progress import Progress, Silent, said
from gs2ci.core.records import Shot
from gs2ci.core.run_records import RunResult
from gs2ci.reconstruct.fit.coarse.looks import Score
from gs2ci.reconstruct.fit.combining.metric import in_given_unit
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.fusion import hand_over
from gs2ci.reconstruct.hypotheses.moving import speeds
from gs2ci.reconstruct.hypotheses.plan import RacePlan, planned
from gs2ci.reconstruct.hypotheses.race import Race
from gs2ci.reconstruct.observe import Tools, observe
from gs2ci.reconstruct.placing import placed
from gs2ci.reconstruct.presets.budget import Budget
from gs2ci.reconstruct.record import Left, record
from gs2ci.reconstruct.registration.register import Registered
from gs2ci.reconstruct.settings import Settings
from gs2ci.reconstruct.threads import one_torch_thread
from gs2ci.reconstruct.uncertainty.of_run import how_sure
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.places import working_on


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
            from telemetry that the shot does not hold; or the settings name a CUDA device that cannot be used.
        ResourceError: That device has too little memory.
        DeviceError: It fails.
        NumericsError: The first fit is not finite from its first iteration on.
    """
    settings, progress, halt = (settings or Settings()).check(), progress or Silent(), halt or Halt()
    settings, placement = placed(shot, settings)
    settings = settings if budget is None else budget.beforehand(settings)
    tools = Tools.load(settings)
    said(placement.notes, progress)
    with working_on(tools.backend.device):
        seen = observe(shot, settings, tools, progress, score, halt, registered)
        halt.begin()
        fits, allowed = seen.fits.within(budget, seen.first)
        raced = Race(fits).run(seen.first, seen.order)
        ensemble, geometry = raced.ensemble, raced.geometry
        renderer = ShotRenderer(fits.fitted.shot, geometry.intrinsics, tools.backend, fits.lens, fits.mask_moments)
        if tools.fine is not None and ensemble.best.scene.motion is None and not halt.asked:
            ensemble = fits.fine(ensemble, renderer, tools.fine)
        progress.stage("views")
        recovered = hand_over(raced.first, ensemble, fits.refine, fits.settings, raced.motion.polishing)
        recovered = recovered.in_the_middle(ensemble, renderer)
        geometry, ensemble = in_given_unit(geometry, ensemble)
        light = renderer.stopped_light(ensemble.best.scene, ensemble.best.world_to_camera)
        moved = speeds(renderer, ensemble.best.scene, ensemble.best.world_to_camera)
        fits.clock.lap("fit")
        look, sure = raced.look.with_decode_of(raced.first), None
        if settings.uncertainty:
            sure = how_sure(look, geometry, ensemble, recovered, renderer, light)
            fits.clock.lap("uncertainty")
    doubts = (*seen.doubts, *allowed, *halt.told(progress))
    stages = (seen.registered, doubts, look, raced, geometry, ensemble, light, recovered, moved)
    left = Left(*stages, fits.mask_moments, sure, placement)
    return Reconstruction(record(fits.settings, left, fits.score, fits.clock.seconds()), ensemble.best.scene)


@one_torch_thread()
def plan(shot: Shot, settings: Settings | None = None, progress: Progress | None = None) -> RacePlan:
    """Foresee what a reconstruction without a budget will try, and how long it will take; nothing is fitted.

    The measurement is observed as for a reconstruction, and a few iterations and a step of each decode are timed.
    Arguments and errors as for `reconstruct`.
    """
    (settings, _), progress = placed(shot, (settings or Settings()).check()), progress or Silent()
    tools = Tools.load(settings)
    with working_on(tools.backend.device):
        seen = observe(shot, settings, tools, progress, None, Halt(), None)
        return planned(seen.fits, seen.first)
