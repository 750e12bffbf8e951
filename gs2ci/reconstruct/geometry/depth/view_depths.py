"""Depth of several views, of a path that turns far: each view sees sides of the scene that the others do not.

A plane sweep compares the reference view with all others. Around an object, most of them see other surfaces, and a
scene that begins with what the reference view sees has nothing on its other sides: from decoded photographs, 77° from
the first view to the last, scenes along the right path ended 2 to 4 dB lower than from several views' depths, each
swept with the views nearest to it (docs/decisions/wide-baseline.md).

Along a path that is wrong the depths of the views contradict each other: along one that matches on a real turning fan
gave, they agreed no better than depths at random (docs/decisions/wide-baseline.md).

Here: when a path turns far, which views are swept, their depths, how far these agree, and where views show points. Not
here: the sweep (`sweep`), the points that follow (`points`).
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.cameras import in_camera, in_world
from gs2ci.core.lens import seen_by
from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings, SweptViews, inverse_depth_range
from gs2ci.reconstruct.geometry.path.motion import rays

# Patches of decoded views can be tracked over about so large a turn.
_FAR_DEG: Final = 15.0
# At most so many views are swept, and each with so many others. With four others scenes were 1.4 dB worse in one set of
# photographs, and equal in another.
_MOST_SWEPT: Final = 8
NEIGHBOURS: Final = 3
# Depths of two views are the same where they differ by no more than this share. With a third of it there were 40 % more
# first points, and scenes were no better.
_SAME_DEPTH: Final = 0.03
# The agreement of the views' depths at which they confirm a path: 0.51 to 0.55 along right paths, 0.37 and 0.54 where
# 59 % of the pictures were black, 0.02 along a wrong one.
_LEAST_AGREEMENT: Final = 0.1
# The agreement is taken at every so many pixels, along rows and columns.
_EVERY: Final = 3


@dataclass(frozen=True)
class ViewDepth:
    """Depth of one view.

    Args:
        view: Its index.
        inverse_depth: [H, W] float32, in its own axes, in the scale of the poses.
    """

    view: int
    inverse_depth: F32


def turns_far(world_to_camera: F64) -> bool:
    """Tell whether some views of a path, [N, 4, 4], are turned so far against others that they see other surfaces."""
    return largest_turn_deg(world_to_camera) >= _FAR_DEG


def largest_turn_deg(world_to_camera: F64) -> float:
    """Return the largest angle between the viewing directions of a path's views, [N, 4, 4], degrees."""
    return math.degrees(_turns(world_to_camera).max())


def view_depths(
    views: F32, world_to_camera: F64, intrinsics: F64, reference: int, points: F64, settings: SweepSettings
) -> tuple[ViewDepth, ...]:
    """Sweep the reference view and others that are turned as far as possible against those swept before.

    Args:
        views: [N, H, W, C] float32 in [0, 1].
        world_to_camera: Poses, [N, 4, 4].
        intrinsics: Camera matrix in px, [3, 3]; pixel centres at +0.5.
        reference: Index of the reference view.
        points: Of the scene, [P, 3], which give each view's range of depth.
        settings: How finely to sweep.

    Returns:
        The depths, the reference view's first; without those of views that see no point in front of them.
    """
    turns = _turns(world_to_camera)
    swept, found = SweptViews(views, settings), []
    for view in _spread(turns, reference):
        depths = points @ world_to_camera[view, 2, :3] + world_to_camera[view, 2, 3]
        if not (depths > 0).any():
            continue
        span = inverse_depth_range(1 / depths[depths > 0], settings)
        order = np.argsort(turns[view], kind="stable")
        order = np.concatenate([[view], order[order != view][:NEIGHBOURS]])
        poses = world_to_camera[order] @ np.linalg.inv(world_to_camera[view])
        found.append(ViewDepth(view, swept.depth(order.tolist(), poses, intrinsics, span)))
    return tuple(found)


def _turns(world_to_camera: F64) -> F64:
    """Return the angles between the viewing directions of all pairs of views, [N, N], rad.

    Turning about the viewing direction shows no other surface, and leaves a reversed path possible.
    """
    ahead = world_to_camera[:, 2, :3]
    across = np.linalg.norm(np.cross(ahead[:, None], ahead[None]), axis=2)
    return np.arctan2(across, ahead @ ahead.T)


def _spread(turns: F64, first: int) -> list[int]:
    """Choose views, each the one farthest from those chosen before."""
    chosen = [first]
    while len(chosen) < min(_MOST_SWEPT, len(turns)):
        nearest = turns[chosen].min(axis=0)
        nearest[chosen] = -1
        chosen.append(int(nearest.argmax()))
    return chosen


def known(points: F64, depth: ViewDepth, world_to_camera: F64, intrinsics: F64) -> Bool:
    """Tell which points, [P, 3], lie on the surface that a view's depth shows; poses as of `view_depths`."""
    inside, along, shown = _compared(points, depth, world_to_camera, intrinsics)
    found = np.zeros(len(points), bool)
    found[inside] = _alike(along, shown)
    return found


def depths_agree(depths: tuple[ViewDepth, ...], world_to_camera: F64, intrinsics: F64) -> bool:
    """Tell whether the depths of several views agree clearly more often than depths at random would."""
    return agreement(depths, world_to_camera, intrinsics) >= _LEAST_AGREEMENT


def agreement(depths: tuple[ViewDepth, ...], world_to_camera: F64, intrinsics: F64) -> float:
    """Compare the depths of all pairs of views.

    Args:
        depths: Of the views.
        world_to_camera: Poses of all views, [N, 4, 4].
        intrinsics: Camera matrix in px, [3, 3]; pixel centres at +0.5.

    Returns:
        The share of points of one view on the surface that another shows, less the share that is expected by chance, as
        a share of what is left to 1 (Cohen's kappa): 1 for the same surface, 0 for depths at random. The chance is
        that of the other view's depths in random order. 0 if no point of one view is in the picture of another.
    """
    draw = np.random.default_rng(0)
    agreed = by_chance = compared = 0
    for one in depths:
        points = _points(one, world_to_camera[one.view], intrinsics)
        for other in depths:
            if other is one:
                continue
            _, along, shown = _compared(points, other, world_to_camera, intrinsics)
            agreed += int(_alike(along, shown).sum())
            by_chance += int(_alike(along, draw.permutation(shown)).sum())
            compared += len(shown)
    return (agreed - by_chance) / (compared - by_chance) if compared > by_chance else 0.0


def grid(size: tuple[int, ...], step: int) -> F64:
    """List the centres of every `step`-th pixel, along rows and columns, as (x, y), [P, 2]."""
    y, x = np.mgrid[0 : size[0] : step, 0 : size[1] : step]
    return np.stack([x.ravel(), y.ravel()], axis=1) + 0.5


def project(points: F64, pose: F64, intrinsics: F64) -> tuple[F64, F64]:
    """Project points, [P, 3], to pixels, [P, 2], NaN behind the camera, and depths, [P]."""
    seen = in_camera(points, pose) @ intrinsics.T
    depth = seen[:, 2]
    return seen[:, :2] / np.where(depth > 0, depth, np.nan)[:, None], depth


def _points(depth: ViewDepth, pose: F64, intrinsics: F64) -> F64:
    """Lift some pixels of a view to the world, [P, 3]."""
    pixels = grid(depth.inverse_depth.shape, _EVERY)
    columns, rows = pixels.astype(int).T
    return in_world(rays(pixels, intrinsics) / depth.inverse_depth[rows, columns, None], pose)


def _compared(points: F64, depth: ViewDepth, world_to_camera: F64, intrinsics: F64) -> tuple[Bool, F64, F32]:
    """Return which points, [P, 3], a view's picture shows, their depths in it, and the inverse depths it has there."""
    inside, along, pixels = seen_by(points, world_to_camera[depth.view], intrinsics, depth.inverse_depth.shape)
    columns, rows = pixels[inside].astype(int).T
    return inside, along[inside], depth.inverse_depth[rows, columns]


def _alike(along: F64, inverse_depth: F32) -> Bool:
    return np.abs(along * inverse_depth - 1) < _SAME_DEPTH
