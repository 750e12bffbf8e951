"""Similarities between the frames of exposures: scale, rotation and translation.

Each exposure alone has a frame and a unit of its own. Here: the record, its use on points and poses, and small changes
of it about a centre. Not here: how one is found (`pairs`, `loops`).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import rigid

CHANGES = 7
"""Numbers of a small change: rotation vector, movement of the centre, logarithm of the scale."""


@dataclass(frozen=True)
class Similarity:
    """x_target = scale · rotation · x_source + translation.

    Args:
        scale: Above 0: a length of 1 of the source in the target's unit.
        rotation: [3, 3], a proper rotation.
        translation: [3], in the target's unit.
    """

    scale: float
    rotation: F64
    translation: F64

    @classmethod
    def identity(cls) -> "Similarity":
        """Return the similarity that changes nothing."""
        return cls(1.0, np.eye(3), np.zeros(3))

    @property
    def inverse(self) -> "Similarity":
        """Get source_from_target."""
        back = self.rotation.T
        return Similarity(1 / self.scale, back, -(back @ self.translation) / self.scale)

    def after(self, first: "Similarity") -> "Similarity":
        """Return the similarity that applies another one first."""
        return Similarity(self.scale * first.scale, self.rotation @ first.rotation, self.points(first.translation))

    def points(self, points: F64) -> F64:
        """Return points of the source, [..., 3], in the target."""
        return self.scale * points @ self.rotation.T + self.translation

    def poses(self, world_to_camera: F64) -> F64:
        """Return poses of the source, [N, 4, 4], in the target: rigid motions in its unit."""
        turned = world_to_camera[:, :3, :3] @ self.rotation.T
        return rigid(turned, self.scale * world_to_camera[:, :3, 3] - turned @ self.translation)

    def changed(self, change: F64, centre: F64, unit: float) -> "Similarity":
        """Return this similarity after a small change.

        Args:
            change: Rotation vector in the target, rad; movement of the centre in the target in units; change of the
                logarithm of the scale; [7].
            centre: A point of the source, [3], about which scale and rotation change.
            unit: A length of the target.
        """
        rotation = Rotation.from_rotvec(change[:3]).as_matrix() @ self.rotation
        scale = self.scale * float(np.exp(change[6]))
        return Similarity(scale, rotation, self.points(centre) + unit * change[3:6] - scale * rotation @ centre)

    def change_to(self, other: "Similarity", centre: F64, unit: float) -> F64:
        """Return the change, [7], that makes this similarity another one; arguments as of `changed`."""
        turn = Rotation.from_matrix(other.rotation @ self.rotation.T).as_rotvec()
        moved = (other.points(centre) - self.points(centre)) / unit
        return np.concatenate([turn, moved, [np.log(other.scale / self.scale)]])
