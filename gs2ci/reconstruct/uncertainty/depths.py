"""Standard errors of depths, pixel by pixel.

A depth errs with the path, by which all depths shift together; as far as a turn in step with the travel may take the
travel's place; by the error of a point's place in each view, the more the less the point moves through the views; by
the thickness of the light that it is the median of; and where near and far meet, because an edge may lie a pixel off.
Here: these together. Not here: that turn (`poses`), the factors (`factors`).
"""

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.uncertainty.factors import factors
from gs2ci.reconstruct.uncertainty.information import ReadingsSeen
from gs2ci.reconstruct.uncertainty.slopes import slopes


def errors_of_depths(seen: ReadingsSeen, spread: F32, path_error: float, turn: float) -> F32:
    """Return the standard error of each depth, [N, H, W], in its unit; 0 where there is no depth.

    If no stage or file gave the unit of lengths, it is that beyond the scale of the median depth, which no image
    determines.

    Args:
        seen: Depths and poses, and the views along them.
        spread: Of the light along the ray, as a share of depth, [N, H, W].
        path_error: Expected error of the path, as a share of its extent.
        turn: In step with the travel, that readings do not see (`unseen_turn`), rad.
    """
    depth = seen.depth
    there = depth > 0
    if not there.any():
        return np.zeros_like(depth)
    middle, found = float(np.median(depth[there])), np.zeros_like(depth)
    moved_by_turn = turn * float(seen.focal_px.mean()) * np.sqrt(len(depth))
    # View by view, since the float64 maps of all views of a large exposure may not fit into memory at once.
    for view in range(len(depth)):
        own = _ahead(depth[view].astype(np.float64))
        ray_ends = np.concatenate([seen.rays, np.ones_like(seen.rays[..., :1])], axis=-1) * own[..., None]
        moved = movement(seen.world_to_camera, seen.focal_px, view, ray_ends)
        jump = np.hypot(*slopes(np.log(np.where(there[view], own, np.nan))))
        jump = np.minimum(np.nan_to_num(jump, nan=factors.most_of_jump), factors.most_of_jump)
        by_path = factors.depth_by_path * path_error * (factors.at_middle + np.abs(own / middle - 1))
        # The travel that the turn stands for moves a point as its inverse depth says, the turn as the middle one's. The
        # more of a point's movement may be turn, the less its depth tells how far from the middle it lies.
        share = np.minimum(moved_by_turn / moved, 1)
        by_turn = share * np.hypot(middle / own - 1, share * factors.unknown_depth)
        by_light = np.hypot(factors.depth_by_spread * spread[view], factors.depth_by_jump * jump)
        relative = np.sqrt((factors.place_px / moved) ** 2 + by_light**2 + by_path**2 + by_turn**2)
        found[view] = np.where(there[view], np.minimum(relative, 1) * own, 0)
    return found


def _ahead(depth: F64) -> F64:
    """Return depths with 1 where there is none."""
    return np.where(depth > 0, depth, 1)


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
    return np.maximum(moved, factors.place_px)
