"""Points of the surfaces that a run's views see: where pixels lie in the world, and a cloud of them in a PLY file.

Here: pixels to points, normals, the cloud and its file. Not here: depth itself (`gs2ci.render.stopping`), lengths
between points (`gs2ci.evaluate.measuring`).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.cameras import SAME_SURFACE
from gs2ci.core.lens import pixel_centres, rays_of, seen_by
from gs2ci.core.whole_file import write_whole
from gs2ci.render.ply import named_columns, ply_bytes

# Below this confidence pixels are left out of the cloud: semi-transparent parts and edges between near and far.
_LEAST_CONFIDENCE: Final = 0.5
# Largest number of views that contribute: neighbouring views see the same surfaces.
_VIEWS: Final = 3


@dataclass(frozen=True)
class Cameras:
    """Cameras of one lens.

    Args:
        world_to_camera: [N, 4, 4].
        intrinsics: [3, 3], px.
        distortion: [5] as in `Shot`; None for a pinhole.
    """

    world_to_camera: F64
    intrinsics: F64
    distortion: F64 | None = None

    def rays(self, pixels: F64) -> F64:
        """Return the directions of the rays of pixels, [..., 2] as (x, y), in camera axes with z = 1, [..., 3]."""
        return rays_of(pixels, self.intrinsics, self.distortion)

    def in_world(self, view: int, vectors: F64, *, directions: bool = False) -> F64:
        """Transform points, or directions, [..., 3], from a camera's axes into the world's."""
        rotation, translation = self.world_to_camera[view, :3, :3], self.world_to_camera[view, :3, 3]
        return (vectors if directions else vectors - translation) @ rotation

    def seen(self, points: F64, view: int, size: tuple[int, int]) -> tuple[Bool, F64, F64]:
        """Project points, [P, 3], into a view of a size (height, width); see `gs2ci.core.lens.seen_by`."""
        return seen_by(points, self.world_to_camera[view], self.intrinsics, size, self.distortion)


@dataclass(frozen=True)
class Points:
    """Points on surfaces; P of them.

    Args:
        positions: Positions in the unit of the path, [P, 3] float32.
        normals: Unit normals, towards the camera that saw the point, [P, 3] float32.
        colours: Colours, full scale 1, [P, 3] float32.
        confidence: Confidence of their depth, [P] float32.
    """

    positions: F32
    normals: F32
    colours: F32
    confidence: F32


def of_one_moment(count: int, *, moves: bool) -> slice:
    """Select of so many views those that see all surfaces at the same places: all; if things move, the middle one."""
    return slice(count // 2, count // 2 + 1) if moves else slice(None)


def points_of(depth: F32, confidence: F32, views: F32, cameras: Cameras) -> Points:
    """Collect the surface points that the first, the middle and the last view see.

    Args:
        depth: [N, H, W], 0 at pixels without a depth.
        confidence: Its confidence, [N, H, W].
        views: [N, H, W, C].
        cameras: Cameras of the views.
    """
    rays = cameras.rays(pixel_centres(depth.shape[1:]))
    parts = []
    for view in np.unique(np.linspace(0, len(depth) - 1, min(_VIEWS, len(depth))).round()).astype(int):
        seen = rays * depth[view][..., None]
        normals, sound = _normals(seen, depth[view])
        sound &= confidence[view] >= _LEAST_CONFIDENCE
        positions = cameras.in_world(view, seen[sound])
        normals = cameras.in_world(view, normals[sound], directions=True)
        colours = np.broadcast_to(np.clip(views[view][sound], 0, 1), (len(positions), 3))
        parts.append((positions, normals, colours, confidence[view][sound]))
    return Points(*(np.concatenate(column).astype(np.float32) for column in zip(*parts, strict=True)))


def surface_points(depth: F32, cameras: Cameras, confidence: F32 | None = None) -> F64:
    """Return where the pixels with a sure depth lie in the world, [P, 3].

    Args:
        depth: [N, H, W], 0 at pixels without a depth.
        cameras: Cameras of the views.
        confidence: Of depth, [N, H, W]; None takes every depth for sure.
    """
    sure = depth > 0 if confidence is None else (depth > 0) & (confidence >= _LEAST_CONFIDENCE)
    found = [np.zeros((0, 3))]
    for view in range(len(depth)):
        row, column = np.nonzero(sure[view])
        rays = cameras.rays(np.stack([column + 0.5, row + 0.5], axis=-1))
        found.append(cameras.in_world(view, rays * depth[view, row, column, None]))
    return np.concatenate(found)


def _normals(seen: F64, depth: F32) -> tuple[F64, Bool]:
    """Return the normals of a view's points, [H, W, 3], and where all four neighbours lie on one surface, [H, W]."""
    height, width = depth.shape
    normals, sound = np.zeros_like(seen), np.zeros((height, width), bool)
    if min(height, width) < 3:
        return normals, sound
    inner = np.s_[1:-1, 1:-1]
    across, down = seen[1:-1, 2:] - seen[1:-1, :-2], seen[2:, 1:-1] - seen[:-2, 1:-1]
    # Rows count downwards, and z forwards: down × across points at the camera.
    product = np.cross(down, across)
    length = np.linalg.norm(product, axis=-1)
    here = depth[inner]
    neighbours = (depth[1:-1, 2:], depth[1:-1, :-2], depth[2:, 1:-1], depth[:-2, 1:-1])
    alike = [(other > 0) & (np.abs(other - here) <= SAME_SURFACE * here) for other in neighbours]
    sound[inner] = (here > 0) & (length > 0) & np.all(alike, axis=0)
    normals[inner] = product / np.where(length > 0, length, 1.0)[..., None]
    return normals, sound


def write_points(path: Path, points: Points) -> Path:
    """Write points as binary little-endian PLY: x y z, nx ny nz, red green blue in 8 bits, confidence.

    Raises:
        StorageError: The file cannot be written.
    """
    properties = {
        **named_columns(("x", "y", "z"), points.positions),
        **named_columns(("nx", "ny", "nz"), points.normals),
        **named_columns(("red", "green", "blue"), np.rint(255 * points.colours).astype(np.uint8)),
        "confidence": points.confidence,
    }
    return write_whole(path, ply_bytes(properties))
