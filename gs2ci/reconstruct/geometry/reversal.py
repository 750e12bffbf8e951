"""The same measurement inside out: near for far, the camera going the other way.

Seen from far away, a scene and its depth reversal move alike (the Necker reversal; Koenderink and van Doorn 1991): with
inverse depths ρ → c − ρ, translations t → −t and a turn that makes up for the difference, to first order in the motion

    f (ω + t ρ) = f (ω + c t − t (c − ρ)).

What tells them apart is of second order, perspective, which tracks see if the field of view is wide and the camera
model right; and what hides what, which only pixels see. And the turn: a camera that a stage carries past a scene hardly
turns, and the picture moves against its travel everywhere. Inside out, the same picture would move with the travel, by
a turn that outruns the parallax of the nearest point. Here: the reversal of a geometry, and how much of the picture's
motion its travel explains. Not here: the reversal of a motion, and by how much tracks prefer it (`motion`), the
comparison by pixels (`attempts/order.py`).
"""

from dataclasses import replace
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64
from gs2ci.reconstruct.geometry.initialise import Geometry

# Reflected inverse depths stay above this share of their median: what lay nearer than twice the median would else lie
# behind the camera.
FARTHEST: Final = 0.05
# Pixels that the motion of a picture is taken at, along either side: it is smooth but for a few edges.
_SAMPLES: Final = 48


def reversed_geometry(geometry: Geometry) -> Geometry:
    """Turn a geometry inside out, its depths reflected at their median; the rest of it is as it was.

    Exact for a distant scene and a small motion; of others it is where an adjustment may begin.
    """
    depth = geometry.inverse_depth.astype(np.float64)
    c = 2 * float(np.median(depth))
    reflected = np.maximum(c - depth, FARTHEST * c / 2).astype(np.float32)
    return replace(geometry, world_to_camera=reversed_poses(geometry.world_to_camera, c), inverse_depth=reflected)


def reversed_poses(world_to_camera: F64, c: float) -> F64:
    """Return the path, [N, 4, 4], that sees a scene of inverse depths c − ρ move as the given one sees ρ move."""
    poses, t = world_to_camera.copy(), world_to_camera[:, :3, 3]
    turns = Rotation.from_rotvec(c * np.stack([-t[:, 1], t[:, 0], np.zeros(len(t))], axis=1)).as_matrix()
    poses[:, :3, :3] = turns @ poses[:, :3, :3]
    poses[:, :3, 3] = -t
    return poses


def share_with_travel(geometry: Geometry) -> float:
    """Return the share of the picture's motion that goes the way in which the camera's travel alone would move it.

    1 for a camera that does not turn; 1/2 where it turns so that the middle of the scene's motion stays put; near 0 for
    the reversal of a camera that does not turn. Each pixel counts by how far it moves along that direction, in all
    views but the reference. 1/2 where nothing moves.

    Args:
        geometry: With poses of which the reference's is the identity.
    """
    points = _points_of(geometry)
    forward = backward = 0.0
    for view, pose in enumerate(geometry.world_to_camera):
        if view == geometry.reference:
            continue
        travelled = _projected(points + pose[:3, 3]) - _projected(points)
        moved = _projected(points @ pose[:3, :3].T + pose[:3, 3]) - _projected(points)
        length = np.linalg.norm(travelled, axis=1)
        seen = (length > 0) & np.isfinite(travelled).all(axis=1) & np.isfinite(moved).all(axis=1)
        along = np.sum(moved[seen] * travelled[seen], axis=1) / length[seen]
        forward += float(along[along > 0].sum())
        backward -= float(along[along < 0].sum())
    both = forward + backward
    return forward / both if both > 0 else 0.5


def _points_of(geometry: Geometry) -> F64:
    """Return where an even grid of the reference's pixels lies in space, [P, 3]."""
    height, width = geometry.inverse_depth.shape
    rows = np.unique(np.linspace(0, height - 1, _SAMPLES).round().astype(int))
    columns = np.unique(np.linspace(0, width - 1, _SAMPLES).round().astype(int))
    down, right = (index.ravel() for index in np.meshgrid(rows, columns, indexing="ij"))
    pixels = np.stack([right + 0.5, down + 0.5, np.ones(len(right))])
    rays = np.linalg.solve(geometry.intrinsics, pixels).T
    return np.asarray(rays / geometry.inverse_depth[down, right, None].astype(np.float64), dtype=np.float64)


def _projected(points: F64) -> F64:
    """Return points in a camera's frame, [P, 3], on the plane at depth 1, [P, 2]; NaN for one in the camera's plane."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(points[:, :2] / points[:, 2:], dtype=np.float64)
