"""Standard errors of depths, pixel by pixel.

A depth errs with the path, by which all depths shift together, not least as far as a turn in step with the travel may
take the travel's place; by the error of a point's place in each view, the more the less the point moves through the
views; by the thickness of the light that it is the median of; and where near and far meet, because an edge may lie a
pixel off. Here: these together. Not here: the covariance (`information`), that turn (`poses`), the factors (`factors`).
"""

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.uncertainty import factors
from gs2ci.reconstruct.uncertainty.information import Information, ReadingsSeen
from gs2ci.reconstruct.uncertainty.poses import relief, travel_across
from gs2ci.reconstruct.uncertainty.slopes import slopes


def errors_of_depths(known: Information, seen: ReadingsSeen, spread: F32, path_error: float, *, given: bool) -> F32:
    """Return the standard error of each depth, [N, H, W], in its unit; 0 where there is no depth.

    Args:
        known: What the readings tell.
        seen: Depths and poses, and the views along them.
        spread: Of the light along the ray, as a share of depth, [N, H, W].
        path_error: Expected error of the path, as a share of its extent.
        given: Whether a stage or a file gave the poses, and with them the unit of lengths. Otherwise the scale, which
            no image determines, is that of the median depth.
    """
    depth = seen.depth
    there = depth > 0
    if not there.any():
        return np.zeros_like(depth)
    by_poses = (1.0 if given else factors.DEPTH_BY_POSES**2) * _by_poses(known, given=given)
    logarithm = np.log(np.where(there, depth, np.nan).astype(np.float64))
    jump = np.hypot(*slopes(logarithm))
    jump = np.minimum(np.nan_to_num(jump, nan=factors.MOST_OF_JUMP), factors.MOST_OF_JUMP)
    middle = float(np.median(depth[there]))
    off_middle = np.abs(depth / middle - 1)
    shift = 0.0 if given else relief(travel_across(seen.world_to_camera, middle), seen.focal_px)
    by_path = factors.DEPTH_BY_PATH * path_error * (factors.AT_MIDDLE + off_middle)
    by_place = factors.PLACE_PX / _movements(seen)
    by_light = np.hypot(factors.DEPTH_BY_SPREAD * spread, factors.DEPTH_BY_JUMP * jump)
    relative = np.sqrt(by_poses + by_place**2 + by_light**2 + by_path**2 + np.square(shift * off_middle))
    relative = np.minimum(relative, factors.MOST_OF_DEPTH)
    return np.where(there, relative * depth, 0).astype(np.float32)


def _movements(seen: ReadingsSeen) -> F64:
    """Return how far the points of all pixels move through the views per relative change of their depth, [N, H, W]."""
    rays = np.concatenate([seen.rays, np.ones_like(seen.rays[..., :1])], axis=-1).astype(np.float64)
    return np.stack(
        [
            movement(seen.world_to_camera, seen.focal_px, view, rays * np.where(depth > 0, depth, 1)[..., None])
            for view, depth in enumerate(seen.depth)
        ]
    )


def movement(world_to_camera: F64, focal_px: F64, view: int, points: F64) -> F64:
    """Return how far points move through the views per relative change of their depth, px.

    Args:
        world_to_camera: [N, 4, 4].
        focal_px: Focal lengths, [2].
        view: The view along whose rays they move.
        points: In the axes of this view, [..., 3].

    Returns:
        [...]: the root of the sum of squares, over the views, of the change of a point's place beyond the mean change;
        at least so much that no depth errs by more than itself.
    """
    relative = world_to_camera @ np.linalg.inv(world_to_camera[view])
    total = np.zeros((*points.shape[:-1], 2))
    squares = np.zeros(points.shape[:-1])
    for motion in relative:
        # How a point moves in each camera's axes as its depth grows by a share, and where it is.
        along = points @ motion[:3, :3].T
        there = along + motion[:3, 3]
        ahead = np.where(there[..., 2:] > 0, there[..., 2:], np.inf)
        places = (along[..., :2] - there[..., :2] / ahead * along[..., 2:]) / ahead * focal_px
        total += places
        squares += np.square(places).sum(axis=-1)
    moved: F64 = np.sqrt(np.maximum(squares - np.square(total).sum(axis=-1) / len(relative), 0))
    return np.maximum(moved, factors.PLACE_PX)


def _by_poses(known: Information, *, given: bool) -> F64:
    """Return the relative variance that depths have from the path, [N, H, W]."""
    cells, follow = known.cells, known.depths_by_poses
    if not len(follow):
        return np.full(cells.shape, factors.UNKNOWN_DEPTH**2)
    if not given:
        share = np.bincount(cells[cells >= 0].ravel(), minlength=len(follow)).astype(np.float64)
        follow = follow - share @ follow / share.sum()
    variance = np.square(follow).sum(axis=1)
    return np.where(cells >= 0, variance[np.maximum(cells, 0)], factors.UNKNOWN_DEPTH**2)
