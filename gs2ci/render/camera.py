"""What is needed of a pinhole camera: rays of pixels, points to pixels, other resolutions.

Pixel centres lie at +0.5: the first pixel of a row covers [0, 1) and is seen at 0.5. Axes are OpenCV's, x right,
y down, z forward. Not here: lens distortion (`gs2ci.core.lens`, and `sampling.py` for who renders behind it), poses
(`se3.py`). Anyone above `gs2ci.render` may import this file.
"""

import torch
from torch import Tensor


def pixel_rays(intrinsics: Tensor, size: tuple[int, int]) -> Tensor:
    """Return the rays through all pixel centres, scaled to depth 1: a point at depth z is z times its ray.

    Args:
        intrinsics: Camera matrix in pixels, [3, 3].
        size: Height and width, px.

    Returns:
        [H, W, 3] in camera coordinates, dtype of the intrinsics.
    """
    rows, columns = (torch.arange(n, dtype=intrinsics.dtype) + 0.5 for n in size)
    v = (rows - intrinsics[1, 2]) / intrinsics[1, 1]
    u = (columns - intrinsics[0, 2]) / intrinsics[0, 0]
    return torch.stack([u.expand(size), v[:, None].expand(size), torch.ones_like(u).expand(size)], dim=-1)


def unproject(depth: Tensor, intrinsics: Tensor, world_to_camera: Tensor) -> Tensor:
    """Lift a depth map to points in the world.

    Args:
        depth: z in scene units, [H, W].
        intrinsics: [3, 3].
        world_to_camera: [4, 4], rigid.

    Returns:
        [H, W, 3].
    """
    height, width = depth.shape
    points = pixel_rays(intrinsics, (height, width)) * depth[..., None]
    # A row vector times R is R^T times the column: the inverse rotation.
    return (points - world_to_camera[:3, 3]) @ world_to_camera[:3, :3]


def project_points(points: Tensor, intrinsics: Tensor, world_to_camera: Tensor) -> tuple[Tensor, Tensor]:
    """Project points of the world.

    Args:
        points: [..., 3].
        intrinsics: [3, 3].
        world_to_camera: [4, 4], or [..., 4, 4] broadcasting against the points.

    Returns:
        Pixel coordinates [..., 2] and depths [...]. Points at depth 0 or behind have no meaningful pixel.
    """
    rotated = (world_to_camera[..., :3, :3] @ points[..., None]).squeeze(-1)
    camera_points = rotated + world_to_camera[..., :3, 3]
    depth = camera_points[..., 2]
    pixels = camera_points[..., :2] / depth[..., None] * intrinsics.diagonal()[:2] + intrinsics[:2, 2]
    return pixels, depth


def scale_intrinsics(intrinsics: Tensor, scale_x: float, scale_y: float | None = None) -> Tensor:
    """Return the camera matrix of the same view at another resolution.

    With pixel centres at +0.5, image coordinates scale without an offset.

    Args:
        intrinsics: [3, 3].
        scale_x: New width over old width.
        scale_y: New height over old height; None: the same as `scale_x`.
    """
    factors = [scale_x, scale_x if scale_y is None else scale_y, 1.0]
    return intrinsics * torch.tensor(factors, dtype=intrinsics.dtype)[:, None]
