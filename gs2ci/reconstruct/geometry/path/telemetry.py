"""Camera poses as the stage reported them, their errors, the points of tracks under them, and how far a fit moved them.

Here: the triangulation under known poses, and their standard errors. Not here: their refinement in the fit
(`fit/optimiser/poses.py`); the steps from tracks to depth, which are the same for every source of poses (`initialise`).
"""

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import path_extent, relative_to
from gs2ci.core.errors import GeometryError, InputError
from gs2ci.core.records import Shot, check_rigid
from gs2ci.core.run_figures import Moved
from gs2ci.reconstruct.geometry.path.adjustment_kernels import INVERSE_DEPTH_RANGE
from gs2ci.reconstruct.geometry.path.motion import CameraMotion, Sightings, start_motion, with_errors
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks

UNSTATED_SHARE: Final = 0.01
"""Standard error of given positions, as a share of the path's extent, if none is stated: tracks of decoded views cannot
detect an error of this size (`python -m tests.benchmarks given_poses`)."""
# Standard error of a given orientation, px: a turn that moves the picture by less is not visible.
_TURN_PX: Final = 0.1
# Standard deviation, over an even path, of what grows by 1 from its beginning to its end.
_IN_STEP: Final = 12.0**-0.5
# Least error of a position: the resolution of float32 for depths of about 1.
_LEAST_ERROR: Final = float(np.finfo(np.float32).eps)
# If tracks contradict given poses, their standard errors are larger by this factor.
_CONTRADICTED: Final = 5.0
_PASSES: Final = 5  # re-weighted least squares on a nearly linear problem settles in three


def poses_of_stage(shot: Shot) -> F64:
    """Get the poses that the stage reported, [N, 4, 4].

    Raises:
        InputError: There are none, or they are not rigid motions.
    """
    if shot.telemetry_world_to_camera is None:
        raise InputError(
            f"{shot.name} holds no poses from a stage",
            allowed="--geometry tracks",
            remedy="capture with a stage in the rig file",
        )
    check_rigid("telemetry poses", shot.telemetry_world_to_camera)
    return shot.telemetry_world_to_camera


@dataclass(frozen=True)
class PoseErrors:
    """Standard errors of given poses, the same for each component.

    Args:
        position: Of a camera's centre, in the unit of the poses.
        rotation: Of its orientation, rad.
        contradicted: Whether tracks contradict the poses.
        turn: Of a turn in step with the travel, standard deviation over the views, rad; a part of `rotation`.
    """

    position: float
    rotation: float
    contradicted: bool = False
    turn: float = 0.0

    def loosened(self) -> "PoseErrors":
        """Get larger standard errors, for poses that tracks contradict.

        They stay bounded, for two reasons. Some exact poses are contradicted, by errors that all tracks share; and
        without any prior a fit exchanges turning for travel, which views hardly show.
        """
        return PoseErrors(_CONTRADICTED * self.position, _CONTRADICTED * self.rotation, contradicted=True)


def stated_error(shot: Shot, name: Literal["position_error", "turn_error_deg"]) -> float | None:
    """Get a standard error of the stage's poses that a shot's provenance states; None if it states none.

    Returns:
        `provenance["telemetry"][name]`: of a position, in the unit of the poses; or of a turn from the first position
        to the last that the poses do not say, degrees.

    Raises:
        InputError: It is not a finite number above 0.
    """
    telemetry = shot.provenance.get("telemetry")
    error = telemetry.get(name) if isinstance(telemetry, dict) else None
    if error is None:
        return None
    if isinstance(error, bool) or not isinstance(error, (int, float)) or not 0 < error < np.inf:
        raise InputError(
            f"{shot.name} states a {name} of {error!r} for its telemetry",
            allowed="a finite number above 0, or none",
        )
    return float(error)


def errors_of_given(
    world_to_camera: F64, intrinsics: F64, position_error: float | None = None, turn_error_deg: float | None = None
) -> PoseErrors:
    """Return the standard errors of given poses that the views confirm.

    A stage reports positions. It does not report its turns; unless it states how large they may be, these are taken to
    be smaller than what tracks can see.

    Args:
        world_to_camera: [N, 4, 4].
        intrinsics: Camera matrix in px, [3, 3].
        position_error: Standard error of a position, in the unit of the poses; None if it is not stated.
        turn_error_deg: Of a turn in step with the travel, from the first position to the last; None if it is not
            stated.
    """
    position = position_error if position_error is not None else UNSTATED_SHARE * path_extent(world_to_camera)
    turn = 0.0 if turn_error_deg is None else float(np.radians(turn_error_deg)) * _IN_STEP
    rotation = float(np.hypot(_TURN_PX / intrinsics[0, 0], turn))
    return PoseErrors(max(position, _LEAST_ERROR), rotation, turn=turn)


def movement(before: F64, after: F64) -> Moved:
    """Compare world-to-camera poses, [N, 4, 4], up to a common motion, which only changes the world's frame."""
    reference = len(before) // 2
    change = relative_to(after, reference) @ np.linalg.inv(relative_to(before, reference))
    extent = path_extent(before)
    shift = float(np.sqrt((change[:, :3, 3] ** 2).sum(axis=1).mean()))
    angles = Rotation.from_matrix(change[:, :3, :3]).magnitude()
    return Moved(
        rotation_deg=float(np.degrees(np.sqrt((angles**2).mean()))),
        share_of_path=shift / extent if extent > 0 else 0.0,
    )


def place_points(
    tracks: Tracks, world_to_camera: F64, intrinsics: F64, huber_px: float, outlier_px: float
) -> tuple[CameraMotion, Tracks]:
    """Find the depths of tracked points from poses that are known.

    Args:
        tracks: At least one point.
        world_to_camera: Known poses, [N, 4, 4], in any frame and unit.
        intrinsics: Camera matrix in px, [3, 3].
        huber_px: Residual from which on an observation counts less.
        outlier_px: Tracks with a larger residual in any view are dropped.

    Returns:
        The motion relative to the reference view, scaled to a median inverse depth of 1, and the tracks that it
        explains.

    Raises:
        GeometryError: The poses do not move the camera, or put most of the points behind it.
    """
    relative = relative_to(world_to_camera, tracks.reference)
    rotations, translations = relative[:, :3, :3], relative[:, :3, 3]
    sightings = Sightings.of(tracks, intrinsics)
    inverse_depth = _triangulate(rotations, translations, sightings, huber_px)
    unit = float(np.median(inverse_depth))
    if not np.isfinite(unit) or unit <= 0:
        raise GeometryError(
            "the known poses put most tracked points at infinity or behind the camera",
            allowed="world-to-camera poses, OpenCV axes, that move the camera past the scene",
            remedy="check the stage's direction in the camera's frame, or use --geometry tracks",
        )
    motion = replace(
        start_motion(sightings),
        rotations=rotations,
        translations=translations * unit,
        inverse_depth=np.clip(inverse_depth / unit, *INVERSE_DEPTH_RANGE),
    )
    motion = with_errors(motion, sightings)
    explained = motion.explains(outlier_px)
    if not explained.any():
        return motion, tracks
    kept = tracks.keep(explained)
    points = replace(motion, inverse_depth=motion.inverse_depth[explained])
    return with_errors(points, Sightings.of(kept, intrinsics)), kept


def _triangulate(rotations: F64, translations: F64, sightings: Sightings, huber_px: float) -> F64:
    """Solve for the inverse depth of each point, [P].

    A view at R, t sees the ray d at inverse depth ρ in (X + t ρ), X = R d, so that
    ρ (t_x − x t_z) = x X_z − X_x, and the same in y: linear in ρ once weighted by the depth X_z + t_z ρ.
    """
    turned = sightings.rays @ rotations.transpose(0, 2, 1)
    tx, ty, tz = (translations[:, k, None] for k in range(3))
    x, y = sightings.seen_at[..., 0], sightings.seen_at[..., 1]
    slope = np.stack([tx - x * tz, ty - y * tz], axis=-1) * sightings.focal_px
    target = np.stack([x * turned[..., 2] - turned[..., 0], y * turned[..., 2] - turned[..., 1]], axis=-1)
    target = target * sightings.focal_px
    weight = sightings.seen.astype(np.float64)
    # Points seen by only one view, and cameras that do not move, give a slope of 0: such points stay at infinity.
    tiny = np.finfo(np.float64).tiny
    inverse_depth = np.zeros(slope.shape[1])
    for _ in range(_PASSES):
        normal = (weight[..., None] * slope**2).sum(axis=(0, 2))
        inverse_depth = (weight[..., None] * slope * target).sum(axis=(0, 2)) / np.maximum(normal, tiny)
        depth = np.maximum(np.abs(turned[..., 2] + tz * inverse_depth), INVERSE_DEPTH_RANGE[0])
        error = np.linalg.norm(slope * inverse_depth[None, :, None] - target, axis=-1) / depth
        weight = sightings.seen / depth**2 * huber_px / np.maximum(error, huber_px)
    return inverse_depth
