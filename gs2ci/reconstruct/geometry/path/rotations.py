"""Poses of a camera that only turned: all that can be estimated of a path without parallax.

Here: the best rotations for given tracks. Not here: the decision that they suffice (`validity`).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64
from gs2ci.reconstruct.geometry.path.adjustment_kernels import REGULAR, normal_blocks
from gs2ci.reconstruct.geometry.path.motion import (
    USUAL_MOTION,
    MotionSettings,
    Sightings,
    arguments,
    predict_positions,
    rms_px,
    start_motion,
    with_errors,
)
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks

# Rotations of some degrees converge quadratically; ten steps are ample.
_STEPS = 10


@dataclass(frozen=True)
class Rotations:
    """Poses of a camera that only turned, and their residuals.

    Args:
        rotations: Reference to view, [N, 3, 3].
        errors_px: Prediction minus track, [P, N, 2]; NaN in the reference view and where a view does not see the
            point.
        displacement_px: How far they move the points: the median over points, in the view where it is largest.
    """

    rotations: F64
    errors_px: F64
    displacement_px: float

    @property
    def rms_px(self) -> float:
        """Get the root mean square residual over all sightings, in px."""
        return rms_px(self.errors_px)


def fit_rotations(tracks: Tracks, intrinsics: F64, settings: MotionSettings = USUAL_MOTION) -> Rotations:
    """Find the pure rotations that explain all tracks best, by re-weighted Gauss-Newton for each view on its own.

    Args:
        tracks: At least one point.
        intrinsics: Camera matrix in px, [3, 3].
        settings: Gives the Huber width.
    """
    sightings, infinitely_far = Sightings.of(tracks, intrinsics), np.zeros(len(tracks))
    motion = replace(start_motion(sightings), inverse_depth=infinitely_far)
    for _ in range(_STEPS):
        _, normal, slope, *_ = normal_blocks(*arguments(motion, sightings), settings.huber_px)
        turn = np.linalg.solve(normal[:, :3, :3] + REGULAR * np.eye(3), slope[:, :3, None])[..., 0]
        motion = replace(motion, rotations=Rotation.from_rotvec(turn).as_matrix() @ motion.rotations)
    positions = tracks.positions[:, tracks.reference]
    predicted = predict_positions(positions, infinitely_far, motion.world_to_camera, intrinsics)
    moved = np.linalg.norm(predicted - positions[:, None], axis=-1)
    return Rotations(
        rotations=motion.rotations,
        errors_px=with_errors(motion, sightings).errors_px,
        displacement_px=float(np.median(moved, axis=0).max()),
    )
