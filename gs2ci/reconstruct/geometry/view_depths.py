"""Depth of several views, of a path that turns far: each view sees sides of the scene that the others do not.

A plane sweep compares the reference view with all others. Around an object, most of them see other surfaces, and a
scene that begins with what the reference view sees has nothing on its other sides: from decoded photographs, 77° from
the first view to the last, scenes along the right path ended 2 to 4 dB lower than from several views' depths, each
swept with the views nearest to it (docs/decisions/0117-first-points-from-several-views.md).

Here: when a path turns far, which views are swept, and their depths. Not here: the sweep (`surface_map`), the points
that follow (`points`).
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64
from gs2ci.reconstruct.geometry.surface_map import surface_map
from gs2ci.reconstruct.geometry.sweep import SweepSettings, inverse_depth_range

# Patches of decoded views can be tracked over about so large a turn.
_FAR_DEG: Final = 15.0
# At most so many views are swept, and each with so many others. With four others scenes were 1.4 dB worse in one set of
# photographs, and equal in another.
_MOST_SWEPT: Final = 8
_NEIGHBOURS: Final = 3


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
    found = []
    for view in _spread(turns, reference):
        depths = points @ world_to_camera[view, 2, :3] + world_to_camera[view, 2, 3]
        if not (depths > 0).any():
            continue
        span = inverse_depth_range(1 / depths[depths > 0], settings)
        order = np.argsort(turns[view], kind="stable")
        order = np.concatenate([[view], order[order != view][:_NEIGHBOURS]])
        poses = world_to_camera[order] @ np.linalg.inv(world_to_camera[view])
        found.append(ViewDepth(view, surface_map(views[order], poses, intrinsics, 0, span, settings, edges=False)))
    return tuple(found)


def _turns(world_to_camera: F64) -> F64:
    """Return the angles between the viewing directions of all pairs of views, [N, N], rad.

    Turning about the viewing direction shows no other surface, and leaves a reversed path possible.
    """
    ahead = world_to_camera[:, 2, :3]
    across = np.linalg.norm(np.cross(ahead[:, None], ahead[None]), axis=2)
    angles: F64 = np.arctan2(across, ahead @ ahead.T)
    return angles


def _spread(turns: NDArray[np.float64], first: int) -> list[int]:
    """Choose views, each the one farthest from those chosen before."""
    chosen = [first]
    while len(chosen) < min(_MOST_SWEPT, len(turns)):
        nearest = turns[chosen].min(axis=0)
        nearest[chosen] = -1
        chosen.append(int(nearest.argmax()))
    return chosen
