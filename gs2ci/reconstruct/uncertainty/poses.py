"""Standard errors of poses, from the covariance of their twists.

A position errs by its distance from the true one after the similarity that no image determines, a rotation by its angle
against the true one after the turn that all cameras have in common. Here: these, by the covariance. Not here: the
covariance (`information`), the factors (`factors`).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64, rms_of
from gs2ci.core.cameras import camera_centres
from gs2ci.reconstruct.uncertainty.factors import factors

# Of a picture of one pixel, or a path of one place.
_LEAST: Final = 1e-30


def unseen_turn(rays: F32, focal_px: F64, given: float | None = None) -> float:
    """Return the standard error of a turn in step with the travel, whose place travel may take, rad.

    In the mean over the path: a regression on what all pixels show of it, so that it falls with the root of their
    number.

    Args:
        rays: Of the pixels, at z = 1, [H, W, 2].
        focal_px: Focal lengths, [2].
        given: The standard error of given rotations, rad; None if a reconstruction found them.
    """
    x, y = np.moveaxis(rays.astype(np.float64), -1, 0)
    # A turn of 1 rad about the y axis moves the picture by 1 + x² and x y focal lengths, one about x by x y and 1 + y².
    beyond_shift = np.sqrt(x.size * ((np.var(x * x) + np.var(y * y)) / 2 + np.var(x * y)))
    most = factors.turn_prior if given is None else given
    return min(most, factors.unseen_px / max(float(beyond_shift * focal_px.mean()), _LEAST))


def errors_of_poses(
    covariance: F64,
    world_to_camera: F64,
    middle_depth: float,
    turns: tuple[float, float],
    *,
    spread: float = 0.0,
    given: bool,
    everywhere: F64 | None = None,
) -> tuple[F64, F64]:
    """Return the standard errors of positions, in the unit of the path, and of rotations, rad; [N] each.

    Args:
        covariance: Of the poses' twists (translation first, in the cameras' axes), [6 N, 6 N].
        world_to_camera: [N, 4, 4].
        middle_depth: Of the scene, in the unit of the path.
        turns: In step with the travel, rad: that readings do not see (`unseen_turn`), common to exposures that share a
            scene, so that those at the ends turn by more; and that by which fits and the path of the own tracks
            differ.
        spread: Of the places of several fits, in the unit of the path (root mean square).
        given: Whether a stage or a file gave the poses, with standard errors that the covariance contains.
        everywhere: Places of the cameras of all exposures that share the scene, [K, 3], whose similarity it then is;
            None: there are no others.
    """
    count = len(world_to_camera)
    centres = camera_centres(world_to_camera)
    moved = centres - centres.mean(axis=0)
    aligned = _aligned(world_to_camera, moved)
    position = np.sqrt(_squares(aligned @ covariance @ aligned.T).reshape(count, 3).sum(axis=1))
    apart = _turns_apart(world_to_camera)
    rotation = np.sqrt(_squares(apart @ covariance @ apart.T).reshape(count, 3).sum(axis=1))
    everywhere = centres if everywhere is None else everywhere
    middle = everywhere.mean(axis=0)
    own, far, all_far = (np.linalg.norm(one, axis=1) for one in (moved, centres - middle, everywhere - middle))
    length = max(rms_of(own), _LEAST)
    if given:
        return position, np.hypot(rotation, turns[1] * own / length)
    # Both show the one freedom: fits, where they leave it open more than readings do at best.
    in_step = np.minimum(np.maximum(turns[0] * far, turns[1] * own) / length, np.pi)
    # It bends all paths as one, so that the middle errs no less than the ends.
    bend = min(turns[0] * rms_of(all_far) / length, np.pi)
    place = factors.out_of_step * middle_depth * max(*turns, bend)
    # Each misses something: fits begin with the same tracks, and few of them may agree by chance.
    times = max(factors.position, spread / max(rms_of(position), _LEAST))
    return np.maximum(times * position, place), np.hypot(factors.turn * rotation, in_step)


def _squares(matrix: F64) -> F64:
    return np.maximum(np.diag(matrix), 0.0)


def _aligned(world_to_camera: F64, moved: F64) -> F64:
    """Return the map from twists to errors of positions after alignment, [3 N, 6 N]."""
    count = len(moved)
    errors = np.zeros((3 * count, 6 * count))
    gauge = np.zeros((3 * count, 7))
    for view in range(count):
        place = slice(3 * view, 3 * view + 3)
        errors[place, 6 * view : 6 * view + 3] = -world_to_camera[view, :3, :3].T
        gauge[place] = np.hstack([np.eye(3), -np.cross(np.eye(3), moved[view]), moved[view][:, None]])
    return errors - gauge @ np.linalg.pinv(gauge) @ errors


def _turns_apart(world_to_camera: F64) -> F64:
    """Return the map from twists to turns beyond the mean turn, [3 N, 6 N]."""
    count = len(world_to_camera)
    found = np.zeros((count, 3, count, 6))
    apart = np.eye(count) - 1 / count
    found[..., 3:] = apart[:, None, :, None] * world_to_camera[:, :3, :3].transpose(2, 0, 1)
    return found.reshape(3 * count, 6 * count)
