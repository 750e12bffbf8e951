"""The same measurement inside out: near for far, the camera going the other way.

Seen from far away, a scene and its depth reversal move alike (the Necker reversal; Koenderink and van Doorn 1991): with
inverse depths ρ → c − ρ, translations t → −t and a turn that makes up for the difference, to first order in the motion

    f (ω + t ρ) = f (ω + c t − t (c − ρ)).

What tells them apart is of second order, perspective, which tracks see if the field of view is wide and the camera
model right; and what hides what, which only pixels see. Here: the reversal of a geometry, and by how much tracks prefer
a motion to its reversal. Not here: the reversal of a motion (`motion`), the comparison by pixels
(`attempts/order.py`).
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
