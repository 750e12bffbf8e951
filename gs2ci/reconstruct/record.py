"""The record of a run, put together from the results of its stages.

Here: the record's fields and notes. Not here: the stages and their order (`pipeline`), files (`gs2ci.evaluate`).
"""

from dataclasses import asdict, dataclass, field, replace
from typing import Final

import numpy as np
import torch

from gs2ci.core.arrays import F64
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.core.run_figures import CurvePoint, GeometrySection, Moved
from gs2ci.core.run_records import RunResult
from gs2ci.core.uncertainty import Uncertainty
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.fit.coarse.looks import Score
from gs2ci.reconstruct.fit.combining.ensemble import Ensemble
from gs2ci.reconstruct.fit.scene.mask_moments import MaskMoments, motion_px
from gs2ci.reconstruct.fit.scene.smear import smeared_views
from gs2ci.reconstruct.fusion import Recovered
from gs2ci.reconstruct.geometry.depth.view_depths import turns_far
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.kinds import PathSource
from gs2ci.reconstruct.geometry.path.centre import doubts_about_centre
from gs2ci.reconstruct.geometry.path.telemetry import movement
from gs2ci.reconstruct.hypotheses.findings import course_findings, order_findings
from gs2ci.reconstruct.hypotheses.moving import Speeds
from gs2ci.reconstruct.hypotheses.race import Raced
from gs2ci.reconstruct.measurement.coding import Coding
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.registration.register import Registered
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.devices import RenderingPlace
from gs2ci.render.stopping import StoppedLight

# The held-out residual, as a share of that of even grey views, above which depth is in doubt. At 0.64 to 0.72 the rank
# correlation of depth with the truth was -0.04 to 0.13; at 0.32 and less it was 0.46 and more.
_NOISY: Final = 0.5
# The held-out residual of the scene, as a multiple of that of the decode, above which its path is in doubt. Views far
# apart along a wrong path left 1.32 times as much as the decode; along right ones 0.63 to 0.71 times (three drawn sets)
# and 1.02 times (photographs, beside a decode by patches). 28 hard cases with a path left 0.53 to 0.96 times as much.
# Around an object, scenes along right paths left up to 1.6 times as much as a decode by patches, and no more than the
# brief decode; along wrong paths, twice as much as the latter or more.
_BEHIND: Final = 1.15


@dataclass(frozen=True)
class Left:
    """The results of the stages, in their order."""

    registered: Registered
    doubts: Findings
    look: FirstLook
    raced: Raced
    geometry: Geometry
    ensemble: Ensemble
    light: StoppedLight
    recovered: Recovered
    speeds: Speeds | None
    mask_moments: MaskMoments | None = None
    uncertainty: Uncertainty | None = None
    placement: RenderingPlace = field(default_factory=RenderingPlace)


def record(settings: Settings, left: Left, score: Score | None, seconds: dict[str, float]) -> RunResult:
    """Put the record of a reconstruction together.

    Args:
        settings: Of the reconstruction.
        left: The results of its stages.
        score: Turns views into the curve's figure, in dB, or None.
        seconds: Wall-clock time of each stage, and in total.

    Raises:
        Gs2ciError: The parts contradict one another, or are not finite.
    """
    shot = left.registered.shot
    geometry, fit, recovered = left.geometry, left.ensemble.best, left.recovered
    moved, light = movement(geometry.world_to_camera, fit.world_to_camera), left.look.brightness
    views, of_weights = light.shown(recovered.views), light.of_weights
    exposed = views if recovered.exposed is None else light.shown(recovered.exposed)
    scene_views = fit.views if recovered.scene_views is None else recovered.scene_views
    lit = shot if of_weights is None else replace(shot, weights=left.look.holdout.shot.weights)
    return RunResult(
        views=views,
        scene_views=light.shown(scene_views),
        decode=views if recovered.is_decode else light.shown(left.look.decoded),
        depth=left.light.surface().numpy(),
        depth_spread=left.light.spread.numpy(),
        depth_confidence=left.light.nearby.numpy(),
        world_to_camera=fit.world_to_camera,
        intrinsics=geometry.intrinsics,
        distortion=shot.distortion,
        predicted_measurement=Coding.of(lit).forward(torch.from_numpy(exposed)).numpy(),
        curve=(*fit.curve, *_last_point(left, score, seconds["total"])),
        stopped=fit.stopped,
        seconds=seconds,
        gaussians=len(fit.scene),
        notes=_notes(left, settings, moved),
        settings=asdict(settings),
        seed=settings.seed,
        verdict=recovered.verdict,
        heldout_rms=recovered.heldout_rms,
        geometry=_summary(geometry, left.look.decoder, settings, moved),
        ensemble=left.ensemble.summary(),
        disagreement=left.ensemble.disagreement,
        brightness=None if of_weights is None else of_weights.tolist(),
        light=light.summary(),
        mask_moments=None if left.mask_moments is None else left.mask_moments.summary(),
        exposed_views=None if recovered.exposed is None else exposed,
        registration=left.registered.summary(),
        motion=left.raced.motion.summary(left.speeds),
        uncertainty=left.uncertainty,
        race=left.raced.course,
        displacement=None if left.speeds is None else left.speeds.displacement_px,
        registered=shot if left.registered.is_changed else None,
        device=left.placement.device,
    ).check()


def _notes(left: Left, settings: Settings, moved: Moved) -> Findings:
    """Gather the findings of every stage, in their order."""
    geometry, ensemble = left.geometry, left.ensemble
    poses_known = geometry.has_path or geometry.known_at_rest
    return (
        *left.placement.notes,
        *left.registered.notes,
        *left.doubts,
        *left.look.notes,
        *(() if left.mask_moments is None else (left.mask_moments.note,)),
        *geometry.notes,
        *order_findings(left.raced.order, geometry),
        *course_findings(left.raced.course, dict(left.raced.motion.heldout_rms)),
        *left.raced.motion.notes(left.speeds, ensemble.best.world_to_camera if poses_known else None),
        *ensemble.notes,
        *_fits_missing(ensemble, settings),
        *_fine_left_out(ensemble, settings),
        *_notes_on_poses(moved, geometry),
        *left.recovered.notes,
        *_depth_in_noise(geometry, left.look.holdout, left.recovered),
        *_path_unconfirmed(geometry, left.recovered, left.look.brief_rms),
        *_smeared(left),
        *_about_centre(geometry, ensemble.best.world_to_camera, left.light),
    )


def _about_centre(geometry: Geometry, world_to_camera: F64, light: StoppedLight) -> Findings:
    """Report that the principal point may move, if a path that neither stage nor file gave turns as if it did."""
    if not geometry.has_path or geometry.is_given:
        return ()
    depth = light.surface()[geometry.reference].numpy()
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0)
    return doubts_about_centre(world_to_camera, geometry.intrinsics, inverse, geometry.reference)


def _depth_in_noise(geometry: Geometry, holdout: Holdout, recovered: Recovered) -> Findings:
    """Report that a depth without given poses is unreliable if the views hardly explain the measurement."""
    if not geometry.has_path or geometry.is_given or geometry.order_given:
        return ()
    rms, grey = recovered.heldout_rms[recovered.verdict], holdout.grey_rms()
    if rms is None or not grey or rms <= _NOISY * grey:
        return ()
    return (finding(Code.DEPTH_IN_NOISE, share=rms / grey),)


def _path_unconfirmed(geometry: Geometry, recovered: Recovered, brief_rms: float | None) -> Findings:
    """Report that the scene along a path predicts the held-out pixels worse than the decode does.

    Worse than the brief decode, if the path turns far: such a scene is hard to fit, even along the right path.
    """
    scene, decode = recovered.heldout_rms["scene"], recovered.heldout_rms["decode"]
    if brief_rms is not None and turns_far(geometry.world_to_camera):
        decode = brief_rms
    if not geometry.has_path or scene is None or not decode or scene <= _BEHIND * decode:
        return ()
    return (finding(Code.PATH_UNCONFIRMED, more=scene / decode - 1),)


def _smeared(left: Left) -> Findings:
    """Report views that look smeared by a camera that moved during the masks, if each mask was fitted with one pose."""
    path = left.ensemble.best.world_to_camera
    if left.mask_moments is not None or len(path) < 2:
        return ()
    open_share = np.clip(left.look.weights_given, 0, 1)
    return smeared_views(left.recovered.views, motion_px(left.geometry, path, open_share))


def _fits_missing(ensemble: Ensemble, settings: Settings) -> Findings:
    there = 1 + len(ensemble.others)
    if there >= settings.fits:
        return ()
    return (finding(Code.FITS_MISSING, fits=there, of=settings.fits),)


def _fine_left_out(ensemble: Ensemble, settings: Settings) -> Findings:
    moves = ensemble.best.scene.motion is not None
    return (finding(Code.FINE_LEFT_OUT),) if moves and settings.fine is not None else ()


def _last_point(left: Left, score: Score | None, seconds: float) -> tuple[CurvePoint, ...]:
    """Return the last point of the curve, that of the mean of several fits; none if the views are no such mean."""
    fit, recovered = left.ensemble.best, left.recovered
    if left.ensemble.averaged == 1 or not recovered.is_refined or not fit.curve:
        return ()
    heldout, psnr_db = recovered.heldout_rms["refined"], None if score is None else score(recovered.views)
    return (replace(fit.curve[-1], seconds=seconds, heldout=heldout, psnr_db=psnr_db),)


def _notes_on_poses(moved: Moved, geometry: Geometry) -> Findings:
    source = geometry.source
    if source == PathSource.TRACKS or geometry.known_at_rest:
        return ()
    if not geometry.has_path:
        return (finding(Code.POSES_NOT_TAKEN, source=source),)
    if source == PathSource.DISPLACEMENTS:
        return ()
    share, rotation_deg = moved.share_of_path, moved.rotation_deg
    return (finding(Code.POSES_MOVED, source=source, share=share, rotation_deg=rotation_deg),)


def _summary(geometry: Geometry, decoder: str, settings: Settings, moved: Moved) -> GeometrySection:
    return GeometrySection(
        method=str(geometry.source),
        asked_for=settings.poses,
        proxy=decoder if settings.proxy == "gap-tv" else settings.proxy,
        verdict=str(geometry.verdict),
        focal_px=float(geometry.intrinsics[0, 0]),
        focal_source=geometry.focal_source,
        tracks=geometry.tracks,
        reprojection_rms_px=geometry.reprojection_rms_px,
        parallax_px=geometry.parallax_px,
        path_error_expected=geometry.path_error_expected,
        order_errors=geometry.order_errors,
        reference=geometry.reference,
        unit_of=None if geometry.unit is None else str(geometry.source),
        moved=moved,
    )
