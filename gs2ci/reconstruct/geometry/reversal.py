"""A geometry with its order of depth reversed: near and far exchanged, the camera travelling the other way.

Seen from far away, a scene and its depth reversal move alike (the Necker reversal; Koenderink and van Doorn 1991): with
inverse depths ρ → c − ρ, translations t → −t and a turn that compensates the difference, to first order in the motion

    f (ω + t ρ) = f (ω + c t − t (c − ρ)).

Three things tell them apart. Perspective, of second order, which tracks show if the field of view is wide and the
camera model right. Occlusion, which only pixels show. And the turn: a camera that a stage moves past a scene hardly
turns, and the picture moves against its travel everywhere; in the reversed order, the same picture would move with the
travel, because the turn would move it more than the parallax of the nearest point. Here: the reversal of a geometry,
and how much of the picture's motion its travel explains. Not here: the reversal of a motion, and how much tracks prefer
it (`motion`), which order is taken (`hypotheses/order.py`).
"""

from dataclasses import replace
from typing import Final

import numpy as np

from gs2ci.reconstruct.geometry.depth.view_depths import grid
from gs2ci.reconstruct.geometry.initialise import Geometry, OtherOrder
from gs2ci.reconstruct.geometry.path.motion import predict_positions, reversed_poses

# Reflected inverse depths stay above this share of their median; otherwise points with more than twice the median would
# lie behind the camera.
FARTHEST: Final = 0.05
# Number of pixels along each side at which the motion of a picture is computed: it is smooth except for a few edges.
_SAMPLES: Final = 48
# Pixels that travel moves by less do not count: rounding does so.
_HARDLY_PX: Final = float(np.sqrt(np.finfo(np.float64).eps))


def reversed_geometry(geometry: Geometry) -> Geometry:
    """Return a geometry with its order of depth reversed: inverse depths reflected at their median, the path reversed.

    Exact for a distant scene and a small motion; for others it is a start for an adjustment. Depths of further views
    and standard errors of given poses are left out.
    """
    depth = geometry.inverse_depth.astype(np.float64)
    c = 2 * float(np.median(depth))
    reflected = np.maximum(c - depth, FARTHEST * c / 2).astype(np.float32)
    poses = reversed_poses(geometry.world_to_camera, c)
    return replace(
        geometry, world_to_camera=poses, inverse_depth=reflected, view_depths=(), pose_errors=None, other_order=None
    )


def turned(geometry: Geometry) -> Geometry:
    """Return the tracks' solution in the other order of depth, or if there is none the reversed geometry."""
    other = geometry.other_order
    if other is None:
        return reversed_geometry(geometry)
    return replace(
        geometry,
        world_to_camera=other.world_to_camera,
        inverse_depth=other.inverse_depth,
        reprojection_rms_px=other.reprojection_rms_px,
        order_errors=None if geometry.order_errors is None else -geometry.order_errors,
        other_order=OtherOrder.of(geometry),
        view_depths=(),
    )


def share_with_travel(geometry: Geometry) -> float:
    """Return the share of the picture's motion that has the direction in which the camera's travel alone would move it.

    1 for a camera that does not turn; 1/2 for one that turns to keep the middle of the scene in place; near 0 for the
    reversal of a camera that does not turn. Each pixel counts by how far it moves along that direction, in all views
    but the reference. 1/2 if nothing moves.

    Args:
        geometry: With poses of which the reference's is the identity.
    """
    shape = geometry.inverse_depth.shape
    pixels = grid(shape, max(1, min(shape) // _SAMPLES))
    columns, rows = pixels.astype(int).T
    depth, poses = geometry.inverse_depth[rows, columns].astype(np.float64), geometry.world_to_camera
    unturned = poses.copy()
    unturned[:, :3, :3] = np.eye(3)
    travelled, moved = (
        predict_positions(pixels, depth, path, geometry.intrinsics) - pixels[:, None] for path in (unturned, poses)
    )
    length = np.linalg.norm(travelled, axis=-1)
    along = np.sum(moved * travelled, axis=-1)[length > _HARDLY_PX] / length[length > _HARDLY_PX]
    forward, both = float(along[along > 0].sum()), float(np.abs(along).sum())
    return forward / both if both > 0 else 0.5
