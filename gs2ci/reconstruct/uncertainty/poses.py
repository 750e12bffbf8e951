"""Standard errors of poses, from the covariance of their twists.

A position errs by its distance from the true one after the similarity that no image determines, a rotation by its angle
against the true one after the turn that all cameras have in common. Here: these, by the covariance. Not here: the
covariance (`information`), the factors (`factors`).
"""

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import camera_centres
from gs2ci.reconstruct.uncertainty.factors import factors


def travel_across(world_to_camera: F64, middle_depth: float) -> F64:
    """Return the angles by which travel across the line of sight moves the middle depth, from the mean place, rad, [N].

    Args:
        world_to_camera: [N, 4, 4].
        middle_depth: Of the scene, in the unit of the path.
    """
    centres = camera_centres(world_to_camera)
    across = (centres - centres.mean(axis=0)) @ world_to_camera[len(centres) // 2, :2, :3].T
    angles: F64 = np.hypot(*across.T) / middle_depth
    return angles


def relief(across: F64, focal_px: F64) -> float:
    """Return the standard error of all inverse depths' common shift, as a share of the middle one; at most 1.

    As much of each camera's travel across the line of sight may be a turn instead.

    Args:
        across: Of each camera, rad, [N].
        focal_px: Focal lengths, [2].
    """
    seen_px = float(across.max() * focal_px.mean())
    return factors.relief_px / max(seen_px, factors.relief_px)


def errors_of_poses(
    covariance: F64, world_to_camera: F64, middle_depth: float, focal_px: F64, *, given: bool
) -> tuple[F64, F64]:
    """Return the standard errors of positions, in the unit of the path, and of rotations, rad; [N] each.

    Args:
        covariance: Of the poses' twists (translation first, in the cameras' axes), [6 N, 6 N].
        world_to_camera: [N, 4, 4].
        middle_depth: Of the scene, in the unit of the path.
        focal_px: Focal lengths, [2].
        given: Whether a stage or a file gave the poses, with standard errors that the covariance contains.
    """
    count = len(world_to_camera)
    centres = camera_centres(world_to_camera)
    moved = centres - centres.mean(axis=0)
    aligned = _aligned(world_to_camera, moved)
    position = np.sqrt(_squares(aligned @ covariance @ aligned.T).reshape(count, 2, 3)[:, 0].sum(axis=1))
    apart = _turns_apart(world_to_camera)
    rotation = np.sqrt(_squares(apart @ covariance @ apart.T).reshape(count, 3).sum(axis=1))
    if given:
        return position, rotation
    across = travel_across(world_to_camera, middle_depth)
    per_travel = np.hypot(factors.turn_per_travel, relief(across, focal_px))
    return factors.position * position, np.hypot(factors.turn * rotation, per_travel * across)


def _squares(matrix: F64) -> F64:
    found: F64 = np.maximum(np.diag(matrix), 0.0)
    return found


def _aligned(world_to_camera: F64, moved: F64) -> F64:
    """Return the map from twists to errors after alignment, [6 N, 6 N]: position, then turn, of each camera."""
    count = len(moved)
    errors = np.zeros((6 * count, 6 * count))
    gauge = np.zeros((6 * count, 7))
    weights = np.ones(6 * count)
    extent = float(np.linalg.norm(np.ptp(moved, axis=0)))
    for view in range(count):
        place, turn = slice(6 * view, 6 * view + 3), slice(6 * view + 3, 6 * view + 6)
        errors[place, place] = -world_to_camera[view, :3, :3].T
        errors[turn, turn] = world_to_camera[view, :3, :3].T
        gauge[place] = np.hstack([np.eye(3), -np.cross(np.eye(3), moved[view]), moved[view][:, None]])
        gauge[turn, 3:6] = -np.eye(3)
        weights[turn] = factors.turn_counts * extent
    weighted = gauge * weights[:, None]
    return errors - gauge @ (np.linalg.pinv(weighted) * weights) @ errors


def _turns_apart(world_to_camera: F64) -> F64:
    """Return the map from twists to turns beyond the mean turn, [3 N, 6 N]."""
    count = len(world_to_camera)
    found = np.zeros((count, 3, count, 6))
    apart = np.eye(count) - 1 / count
    found[..., 3:] = apart[:, None, :, None] * world_to_camera[:, :3, :3].transpose(2, 0, 1)
    return found.reshape(3 * count, 6 * count)
