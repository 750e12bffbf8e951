"""Errors of a recovered camera path, after alignment by the similarity that no image can determine.

Here: the alignment of two paths, also if the path leaves part of it undetermined, and the errors ATE, nATE, rotation
and RPE. Not here: files, drawing.

A straight stage motion is the usual case of this instrument, and it does not determine the rotation about its own line:
on the published straight paths (cozy2room, vender, factory) the textbook alignment returns mean rotation errors of 121
to 168 degrees, all of it roll fitted to noise, although the cameras agree to 0.05, 0.09 and 2.3 degrees. So the
alignment checks how far the positions determine it, and takes the undetermined part from the cameras' orientations.

Positions cannot distinguish a straight or plane path from the same path run backwards either: half a turn maps one onto
the other. A scene inside out (depth order and path reversed, rotations nearly right) would have no error at all. So if
positions agree only with cameras that are turned over, the orientations decide, and the path is called reversed.
"""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64, rms_of
from gs2ci.core.cameras import rigid
from gs2ci.core.errors import InputError
from gs2ci.core.records import check_rigid
from gs2ci.core.run_figures import Number

Free = Literal["nothing", "roll", "rotation"]

# If a path's centres differ by less than this share of their distance from the origin, the camera stands still: float32
# poses are not more precise than 1e-7, and centres computed from them in float64 scatter less.
STATIC_SHARE: Final = 1e-7
# Positions count as known to this share of the path's extent at best. Otherwise, for two copies of one straight path,
# whose residual is zero, rounding would be taken for a bend: float64 rounds the cross-covariance at 1e-16 of its
# largest entry, which looks like a bend of 1e-8.
POSITION_FLOOR: Final = 1e-6
# If position errors leave the roll about a straight path this uncertain (one standard deviation), they would dominate
# the rotation error, and not the cameras' orientations; good reconstructions are right to tenths of a degree.
ROLL_UNCERTAINTY_DEG: Final = 1.0
# Cameras that see a scene from the same side differ by less than this; a reversed path turns them by half a turn.
TURNED_OVER_DEG: Final = 90.0


@dataclass(frozen=True)
class Alignment:
    """The similarity x_true = scale · rotation · x_estimate + translation, and what determines it.

    Args:
        scale: Above 0; 1 if a camera that stands still leaves it undetermined.
        rotation: [3, 3], a proper rotation: a mirrored path stays mirrored.
        translation: [3], in the unit of the true path.
        free: The part that the positions leave undetermined and that is taken from the orientations: `nothing`; the
            `roll` about a straight path; the whole `rotation` if either camera stands still.
        turned_over_deg: Mean rotation of the cameras by the similarity that fits their centres best, if that exceeds
            `TURNED_OVER_DEG`: the path runs backwards. Then the rotation is that of the orientations, and the scale
            that of the paths' spreads. None otherwise.
    """

    scale: float
    rotation: F64
    translation: F64
    free: Free
    turned_over_deg: float | None = None

    def apply(self, world_to_camera: F64) -> F64:
        """Express estimated poses [N, 4, 4] in the frame and unit of the true path."""
        centers, rotations = _centers(world_to_camera), _camera_to_world_rotations(world_to_camera)
        turned = np.swapaxes(self.rotation @ rotations, 1, 2)
        moved = self.scale * centers @ self.rotation.T + self.translation
        return rigid(turned, -np.einsum("nij,nj->ni", turned, moved))


@dataclass(frozen=True)
class TrajectoryErrors:
    """Errors of a camera path; None if the path is too short or the camera stands still.

    Args:
        ate: Absolute trajectory error: root mean square distance of the camera centres, in the unit of the true
            path, the smallest for any similarity; for a reversed path, under the alignment by orientations.
        nate: `ate` divided by the diagonal of the true path's bounding box; None for two views as well, on which a
            similarity always fits.
        translation_mean: Mean distance of the camera centres under the similarity of `ate`, in the unit of the true
            path.
        rotation_deg: Mean over the views of the angle between the true and the aligned camera orientation; for a
            reversed path, that under the similarity of the centres, which is above `TURNED_OVER_DEG`.
        rpe_t: Relative pose error of consecutive views, translation: root mean square, in the unit of the true
            path, after the estimate has been brought to its scale.
        rpe_r_deg: The same, rotation angle.
        free: The part that the positions leave undetermined, see `Alignment`.
        reversed: Whether the path runs backwards, as in a scene that is inside out.
    """

    ate: Number
    nate: Number | None
    translation_mean: Number
    rotation_deg: Number
    rpe_t: Number | None
    rpe_r_deg: Number | None
    free: Free = "nothing"
    reversed: bool = False


def align(estimate: F64, truth: F64) -> Alignment:
    """Find the similarity that maps an estimated camera path onto the true one.

    It is the least-squares similarity of the camera centres (Umeyama 1991), except for the part that they leave
    undetermined, which is taken from the orientations: the roll about the line if the residual leaves it uncertain by
    more than `ROLL_UNCERTAINTY_DEG`, all of the rotation if a camera stands still, or if that similarity would turn the
    cameras by more than `TURNED_OVER_DEG`. Both are the chordal mean: the rotation with the smallest sum of squared
    differences between the orientation matrices.

    Args:
        estimate: World-to-camera poses, [N, 4, 4].
        truth: The same shape.

    Raises:
        InputError: The shapes differ, there is no pose, or a number is not finite.
    """
    _check_paths(estimate, truth)
    centers, target = _centers(estimate), _centers(truth)
    turns = np.einsum("nij,nkj->ik", _camera_to_world_rotations(truth), _camera_to_world_rotations(estimate))
    fit = _fit_positions(centers, target)
    if fit is None:
        rotation = _nearest_rotation(turns)
        return Alignment(1.0, rotation, target.mean(0) - rotation @ centers.mean(0), "rotation")
    rotation = fit.rotation
    free: Free = "nothing"
    if fit.roll_uncertainty_deg > ROLL_UNCERTAINTY_DEG:
        rotation, free = fit.rolled_towards(turns), "roll"
    scale, turned_over_deg = fit.scale, None
    if (turned_deg := _mean_turn_deg(rotation, estimate, truth)) > TURNED_OVER_DEG:
        rotation, turned_over_deg = _nearest_rotation(turns), turned_deg
        # Least squares would shrink a reversed path to a point, which would hide its direction.
        scale = _rms_length(target - target.mean(0)) / _rms_length(centers - centers.mean(0))
    return Alignment(scale, rotation, target.mean(0) - scale * rotation @ centers.mean(0), free, turned_over_deg)


def trajectory_errors(estimate: F64, truth: F64) -> TrajectoryErrors:
    """Measure the errors of an estimated camera path.

    Args:
        estimate: World-to-camera poses, [N, 4, 4], in any frame and unit.
        truth: The same shape.

    Raises:
        InputError: The shapes differ, there is no pose, a number is not finite, or true poses are no rigid motions.

    The conventions are those of evo (Grupp 2017): ATE is the translation part of the absolute pose error after
    similarity alignment, RPE compares the motions between consecutive views.
    """
    _check_paths(estimate, truth)
    check_rigid("true poses", truth)
    alignment = align(estimate, truth)
    aligned = alignment.apply(estimate)
    centers, target = _centers(estimate), _centers(truth)
    fit = _fit_positions(centers, target)
    backwards = alignment.turned_over_deg is not None
    off_target = _centers(aligned) - target if fit is None or backwards else fit.residuals
    ate, mean = _rms_length(off_target), float(np.mean(np.linalg.norm(off_target, axis=1)))
    diagonal = float(np.linalg.norm(np.ptp(target, axis=0)))
    turned_deg = _mean_turn_deg(alignment.rotation, estimate, truth)
    rpe_t, rpe_r_deg = _relative_pose_errors(aligned, truth)
    return TrajectoryErrors(
        ate=ate,
        nate=None if len(target) < 3 or _stands_still(target) else ate / diagonal,
        translation_mean=mean,
        rotation_deg=turned_deg if alignment.turned_over_deg is None else alignment.turned_over_deg,
        rpe_t=rpe_t,
        rpe_r_deg=rpe_r_deg,
        free=alignment.free,
        reversed=backwards,
    )


def rotation_angles_deg(rotations: F64) -> F64:
    """Measure the angle of each rotation, [N, 3, 3], in degrees, precise from 0 to 180."""
    return np.degrees(Rotation.from_matrix(rotations).magnitude())


@dataclass(frozen=True)
class _PositionFit:
    """The least-squares similarity of the positions in the axes of their cross-covariance U diag(S) Vᵀ."""

    scale: float
    target_axes: F64  # [3, 3], right-handed, along the line first
    source_axes: F64  # [3, 3]
    residuals: F64  # [N, 3], of the positions under this similarity
    roll_uncertainty_deg: float

    @property
    def rotation(self) -> F64:
        """Get target_from_source."""
        return self.target_axes @ self.source_axes.T

    def rolled_towards(self, turns: F64) -> F64:
        """Get the rotation that maps line to line and, of all such, maximises tr(rotationᵀ turns)."""
        across = (self.target_axes.T @ turns @ self.source_axes)[1:, 1:]
        angle = np.arctan2(across[1, 0] - across[0, 1], across[0, 0] + across[1, 1])
        roll = np.array(
            [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]], dtype=np.float64
        )
        return self.target_axes @ roll @ self.source_axes.T


def _fit_positions(source: F64, target: F64) -> _PositionFit | None:
    """Fit x_target = s R x_source + t (Umeyama 1991, eqs. 40 to 43); None where either path stands still."""
    if _stands_still(source) or _stands_still(target):
        return None
    a, b = source - source.mean(0), target - target.mean(0)
    u, spread, vt = np.linalg.svd(b.T @ a / len(a))
    # Right-handed axes on both sides: the last pair then carries Umeyama's sign, and R stays a proper rotation.
    handed_u, handed_v = np.sign(np.linalg.det(u)), np.sign(np.linalg.det(vt))
    target_axes, source_axes = u * (1, 1, handed_u), vt.T * (1, 1, handed_v)
    spread = spread * (1, 1, handed_u * handed_v)
    # For a path without any correlation with the true one the best scale is 0, but a scale must stay above 0.
    scale = max(float(spread.sum() / np.mean(np.sum(a**2, axis=1))), float(np.finfo(np.float64).tiny))
    residuals = scale * a @ (target_axes @ source_axes.T).T - b
    # The squared error grows as 2 N s (S₁ + S₂)(1 − cos roll): with rms²/3 per axis this is the roll's variance.
    grip = scale * len(a) * max(float(spread[1] + spread[2]), 0.0)
    noise = np.hypot(_rms_length(residuals) / np.sqrt(3), POSITION_FLOOR * _rms_length(b))
    uncertainty = np.degrees(noise / np.sqrt(grip)) if grip > 0 else np.inf
    return _PositionFit(scale, target_axes, source_axes, residuals, float(uncertainty))


def _relative_pose_errors(aligned: F64, truth: F64) -> tuple[float | None, float | None]:
    if len(truth) < 2:
        return None, None
    estimate_motion = aligned[:-1] @ np.linalg.inv(aligned[1:])  # pose of the next camera in this one's frame
    true_motion = truth[:-1] @ np.linalg.inv(truth[1:])
    error = np.linalg.inv(true_motion) @ estimate_motion
    angles = rotation_angles_deg(error[:, :3, :3])
    return _rms_length(error[:, :3, 3]), rms_of(angles)


def _mean_turn_deg(rotation: F64, estimate: F64, truth: F64) -> float:
    """Get the mean angle between the true orientations and the estimated ones turned by a rotation, [3, 3]."""
    turned = rotation @ _camera_to_world_rotations(estimate)
    off = np.swapaxes(_camera_to_world_rotations(truth), 1, 2) @ turned
    return float(rotation_angles_deg(off).mean())


def _nearest_rotation(matrix: F64) -> F64:
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u * (1, 1, np.sign(np.linalg.det(u @ vt))) @ vt, dtype=np.float64)


def _stands_still(centers: F64) -> bool:
    spread = _rms_length(centers - centers.mean(0))
    return bool(spread <= STATIC_SHARE * np.abs(centers).max())


def _centers(world_to_camera: F64) -> F64:
    return -np.einsum("nji,nj->ni", world_to_camera[:, :3, :3], world_to_camera[:, :3, 3])


def _camera_to_world_rotations(world_to_camera: F64) -> F64:
    return np.swapaxes(world_to_camera[:, :3, :3], 1, 2)


def _rms_length(vectors: F64) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def _check_paths(estimate: F64, truth: F64) -> None:
    if estimate.shape != truth.shape or estimate.ndim != 3 or estimate.shape[1:] != (4, 4) or not len(estimate):
        raise InputError(
            f"a path {list(estimate.shape)} cannot be compared with a true path {list(truth.shape)}",
            allowed="two stacks of world-to-camera poses [N, 4, 4] with one N >= 1",
        )
    if not (np.isfinite(estimate).all() and np.isfinite(truth).all()):
        raise InputError("a camera path holds values that are NaN or infinite", allowed="finite poses")
