"""Helpers for cameras: the matrix of a pinhole, rigid motions, centres, points in the world, conventions of axes.

Here: numpy only. Not here: lens distortion (`gs2ci.core.lens`), checks (`gs2ci.core.records`), comparison of paths
(`gs2ci.evaluate.trajectory`).
"""

from typing import Final

import numpy as np

from gs2ci.core.arrays import F64

# nerfstudio and OpenGL look along −z with y up; OpenCV and COLMAP look along +z with y down. Its own inverse.
OPENCV_FROM_OPENGL: Final = np.diag([1.0, -1.0, -1.0, 1.0])
# Depths that differ relatively by more than this lie on different surfaces.
SAME_SURFACE: Final = 0.05


def pinhole(focal_px: float, size: tuple[int, ...]) -> F64:
    """Make the camera matrix, [3, 3], of square pixels with the principal point in the middle of the image.

    Args:
        focal_px: Focal length in px.
        size: Height and width in px; pixel centres lie at +0.5.
    """
    height, width = size
    return np.array([[focal_px, 0, width / 2], [0, focal_px, height / 2], [0, 0, 1.0]])


def rigid(rotations: F64, translations: F64) -> F64:
    """Return the rigid motions, [N, 4, 4], of rotations, [N, 3, 3], and translations, [N, 3]; one may serve for all."""
    count = np.broadcast_shapes(rotations.shape[:-2], translations.shape[:-1])
    motions = np.zeros((*count, 4, 4))
    motions[..., :3, :3], motions[..., :3, 3], motions[..., 3, 3] = rotations, translations, 1
    return motions


def camera_centres(world_to_camera: F64) -> F64:
    """Return the camera centres in the world, [N, 3], in its unit, from the poses, [N, 4, 4]."""
    return np.asarray(np.linalg.inv(world_to_camera)[:, :3, 3], np.float64)


def path_extent(world_to_camera: F64) -> float:
    """Return the diameter of a path, [N, 4, 4]: the diagonal of the box around its centres, in the world's unit."""
    return float(np.linalg.norm(np.ptp(camera_centres(world_to_camera), axis=0)))


def relative_to(world_to_camera: F64, view: int) -> F64:
    """Return poses, [N, 4, 4], in the coordinates of one view's camera, whose own is the identity but for rounding."""
    return world_to_camera @ np.linalg.inv(world_to_camera[view])


def in_camera(points: F64, world_to_camera: F64) -> F64:
    """Return points of the world, [..., 3], in the coordinates of a camera of a rigid pose, [4, 4]."""
    return points @ world_to_camera[:3, :3].T + world_to_camera[:3, 3]


def in_world(in_camera: F64, world_to_camera: F64) -> F64:
    """Return points given in a camera's coordinates, [P, 3], in the world of its rigid pose, [4, 4]."""
    return (in_camera - world_to_camera[:3, 3]) @ world_to_camera[:3, :3]
