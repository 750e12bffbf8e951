"""Poses of a camera that only turned: all that can be estimated of a path without parallax.

Here: the best rotations for given tracks. Not here: the decision that they suffice (`validity`).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64
from gs2ci.reconstruct.geometry.path.adjustment_kernels import LEAST_RELATIVE_DEPTH
from gs2ci.reconstruct.geometry.path.motion import REGULAR, MotionSettings, rays, rms_px
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


def fit_rotations(tracks: Tracks, intrinsics: F64, settings: MotionSettings | None = None) -> Rotations:
    """Find the pure rotations that explain all tracks best, by re-weighted Gauss-Newton for each view on its own.

    Args:
        tracks: At least one point.
        intrinsics: Camera matrix in px, [3, 3].
        settings: Gives the Huber width.
    """
    huber_px = (settings or MotionSettings()).huber_px
    seen_at = tracks.positions.transpose(1, 0, 2)
    directions = rays(tracks.positions[:, tracks.reference], intrinsics)
    seen = tracks.seen.T.copy()
    seen[tracks.reference] = False
    rotations = np.tile(np.eye(3), (len(seen), 1, 1))
    for _ in range(_STEPS):
        predicted, jacobian = _predict(rotations, directions, intrinsics)
        error = np.where(seen[..., None], predicted - seen_at, 0.0)
        distance = np.linalg.norm(error, axis=-1)
        weight = np.where(distance < huber_px, 1.0, huber_px / np.maximum(distance, huber_px)) * seen
        weighted = jacobian * weight[..., None, None]
        normal = np.einsum("npai,npaj->nij", weighted, jacobian) + REGULAR * np.eye(3)
        turn = -np.linalg.solve(normal, np.einsum("npai,npa->ni", weighted, error)[..., None])[..., 0]
        rotations = Rotation.from_rotvec(turn).as_matrix() @ rotations
    predicted, _ = _predict(rotations, directions, intrinsics)
    moved = np.linalg.norm(predicted - tracks.positions[None, :, tracks.reference], axis=-1)
    return Rotations(
        rotations=rotations,
        errors_px=np.where(seen[..., None], predicted - seen_at, np.nan).transpose(1, 0, 2),
        displacement_px=float(np.median(moved, axis=1).max()),
    )


def _predict(rotations: F64, directions: F64, intrinsics: F64) -> tuple[F64, F64]:
    """Predict pixels, [N, P, 2], and their Jacobian by ω for R ← exp(ω) R, [N, P, 2, 3]."""
    focal, centre = np.diag(intrinsics)[:2], intrinsics[:2, 2]
    turned = directions @ rotations.transpose(0, 2, 1)
    depth = np.maximum(turned[..., 2:], LEAST_RELATIVE_DEPTH)
    slopes = turned[..., :2] / depth
    # Per focal length: d(x/z)/dω = (−xy, 1 + x², −y), d(y/z)/dω = (−1 − y², xy, x), with z = 1.
    x, y = slopes[..., 0], slopes[..., 1]
    by_x = np.stack([-x * y, 1 + x * x, -y], axis=-1)
    by_y = np.stack([-1 - y * y, x * y, x], axis=-1)
    return slopes * focal + centre, np.stack([by_x * focal[0], by_y * focal[1]], axis=-2)
