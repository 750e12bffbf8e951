"""Positions of the first Gaussians: pixels of the middle view at their depths, and what it does not see.

What it does not see are borders, and, around an object, other sides of it: these come from the depths of further views.

Here: positions, colours and spacing. Not here: opacity, size and orientation, which belong to the fit.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.cameras import in_world
from gs2ci.core.lens import seen_by
from gs2ci.reconstruct.geometry.depth.view_depths import grid, known, project
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.path.motion import rays

# Beyond the middle view's border, depth continues that of the border, smoothed over so many pixels.
_RIM_BLUR_PX = 8.0
# The depth of a border pixel and its position in the middle view depend on each other; they are iterated, and converge
# fast, since the motion is small.
_RIM_STEPS = 3


@dataclass(frozen=True)
class Seeds:
    """Coloured points of the scene.

    Args:
        positions: [P, 3] float32, in the axes of the reference view.
        colours: [P, C] float32 in [0, 1].
        spacing: Distance to neighbours on the grid of pixels, at their depth, [P] float32.
    """

    positions: F32
    colours: F32
    spacing: F32


def seed_points(geometry: Geometry, views: F32, stride: int = 3) -> Seeds:
    """Lift every `stride`-th pixel to its depth.

    Args:
        geometry: Poses and the depth of the reference view.
        views: Decoded views, [N, H, W, C].
        stride: Step between pixels, along rows and columns.

    Returns:
        Points of the reference view; those of further views with depths of their own that are new; then those that only
        other views see, from the farthest view on.
    """
    pixels = grid(views.shape[1:3], stride)
    directions = rays(pixels, geometry.intrinsics)
    at_grid = (pixels[..., 1].astype(int), pixels[..., 0].astype(int))
    inverse_depth = geometry.inverse_depth[at_grid].astype(np.float64)
    positions = [directions / inverse_depth[:, None]]
    colours = [views[geometry.reference][at_grid]]
    spacing = [1 / inverse_depth]
    taken = [geometry.reference]
    for number, depth in enumerate(geometry.view_depths[1:], start=1):
        along = depth.inverse_depth[at_grid].astype(np.float64)
        points = _lifted(geometry, directions, along, depth.view)
        before = geometry.view_depths[:number]
        new = ~np.any([known(points, one, geometry.world_to_camera, geometry.intrinsics) for one in before], axis=0)
        positions.append(points[new])
        colours.append(views[depth.view][at_grid][new])
        spacing.append(1 / along[new])
        taken.append(depth.view)
    smooth = cv2.GaussianBlur(geometry.inverse_depth, (0, 0), _RIM_BLUR_PX, borderType=cv2.BORDER_REPLICATE)
    for i in _farthest_first(geometry, taken):
        rim_depth, points = _rim(geometry, smooth, directions, i)
        new = ~np.any([_sees(geometry, points, j) for j in taken], axis=0)
        positions.append(points[new])
        colours.append(views[i][at_grid][new])
        spacing.append(1 / rim_depth[new])
        taken.append(i)
    scale = stride / float(np.sqrt(geometry.intrinsics[0, 0] * geometry.intrinsics[1, 1]))
    return Seeds(
        positions=np.concatenate(positions).astype(np.float32),
        colours=np.concatenate(colours).astype(np.float32),
        spacing=(np.concatenate(spacing) * scale).astype(np.float32),
    )


def _sees(geometry: Geometry, points: F64, view: int) -> Bool:
    return seen_by(points, geometry.world_to_camera[view], geometry.intrinsics, geometry.inverse_depth.shape)[0]


def _lifted(geometry: Geometry, directions: F64, inverse_depth: F64, view: int) -> F64:
    """Lift pixels of a view, given as directions: points in the axes of the reference view, [P, 3]."""
    return in_world(directions / inverse_depth[:, None], geometry.world_to_camera[view])


def _rim(geometry: Geometry, smooth: F32, directions: F64, view: int) -> tuple[F64, F64]:
    """Lift the pixels of a view to the depth of the nearest pixel of the reference view.

    Returns:
        Inverse depths along the rays of the view, [P], and the points in the axes of the reference view, [P, 3].
    """
    height, width = smooth.shape
    inverse_depth = np.full(len(directions), float(np.median(smooth)))
    for _ in range(_RIM_STEPS):
        points = _lifted(geometry, directions, inverse_depth, view)
        pixels, _ = project(points, geometry.world_to_camera[geometry.reference], geometry.intrinsics)
        nearest = np.nan_to_num(pixels, nan=0.0, posinf=0.0, neginf=0.0).clip(0, (width - 1, height - 1)).astype(int)
        inverse_depth = smooth[nearest[:, 1], nearest[:, 0]].astype(np.float64)
    return inverse_depth, _lifted(geometry, directions, inverse_depth, view)


def _farthest_first(geometry: Geometry, taken: list[int]) -> list[int]:
    """Order views that are not taken yet by how far their image of the scene's middle has moved from the reference."""
    pose = geometry.world_to_camera
    middle = 1 / float(np.median(geometry.inverse_depth))
    points = pose[:, :3, 2] * middle + pose[:, :3, 3]
    shift = np.linalg.norm(points - (0, 0, middle), axis=1)
    return [int(i) for i in np.argsort(-shift, kind="stable") if i not in taken]
