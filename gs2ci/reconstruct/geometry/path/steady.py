"""Errors of given poses that are alike all along a path: a turn in step with the travel, or another direction of it.

A stage reports positions. That its camera turns on the way, or travels in another direction than its mount says, moves
a picture nearly as another depth does: a turn by all inverse depths alike, and only beyond that by the square of the
field of view. So few numbers are asked for, and all tracks together answer: three for the turn from the first view to
the last, or three for the direction. The depth of each point and its place in the reference view are eliminated, since
they are not known. Here: these numbers with their covariance, and the poses corrected by them. Not here: whether given
poses are contradicted (`halves`), what is done about it (`sources.sources`).
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64, I64
from gs2ci.core.cameras import camera_centres
from gs2ci.reconstruct.geometry.path.adjustment_kernels import LEAST_RELATIVE_DEPTH
from gs2ci.reconstruct.geometry.path.halves import cells
from gs2ci.reconstruct.geometry.path.motion import Sightings
from gs2ci.reconstruct.geometry.path.telemetry import triangulate
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks

# What is known of them beforehand, rad: keeps what tracks do not tell (a turn about the line of travel) near zero.
_PRIOR: Final = 0.2
# Gauss-Newton on a few numbers that are nearly linear; derivatives by differences of so much, rad.
_STEPS, _DIFFERENCE = 5, 1e-4
# The errors of tracks are those of one decode: neighbours share them, and some are shared by all. Variances are so many
# times what the residuals and their sums over cells of the picture say together: exact poses of 75 draws then leave
# the median of the squared distance of three numbers.
_SHARED: Final = 3.0
# Squared distance of three numbers that noise exceeds once in a thousand.
_CLEAR: Final = 16.3
# A combination of them that is not so many standard errors from zero is left as the poses have it.
_TOLD: Final = 3.0


class Steady(StrEnum):
    """What errs alike all along a path."""

    TURN = "turn"
    DIRECTION = "direction"


@dataclass(frozen=True)
class SteadyError:
    """An error of given poses, as tracks show it.

    Args:
        kind: What errs.
        by: As a rotation vector, rad, [3], in the axes of the reference camera: from the first view to the last, or of
            the direction of travel. What tracks do not tell of it is zero.
        covariance: Of it, [3, 3].
        is_clear: Whether tracks leave no doubt that it is there.
        world_to_camera: The given poses without it, [N, 4, 4]; the identity for the reference view.
        turned: Root mean square, over the views, of a turn's share in each; 0 for a direction.
        cost: Sum of Huber costs that is left, px².
    """

    kind: Steady
    by: F64
    covariance: F64
    is_clear: bool
    world_to_camera: F64
    turned: float
    cost: float

    @property
    def error(self) -> float:
        """Get its standard error in the direction that is least sure, rad."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance)[-1]))


def steady_error(
    tracks: Tracks, world_to_camera: F64, intrinsics: F64, size: tuple[int, int], huber_px: float
) -> SteadyError:
    """Find the error of given poses, alike all along the path, that explains tracks best.

    Args:
        tracks: At least one point.
        world_to_camera: Given poses of a camera that moves, [N, 4, 4], in any frame and unit.
        intrinsics: Camera matrix in px, [3, 3].
        size: Height and width of the views, px.
        huber_px: Residual from which on an observation counts less.
    """
    group = cells(tracks, size)
    found = (_of_kind(kind, tracks, world_to_camera, intrinsics, group, huber_px) for kind in Steady)
    return min(found, key=lambda one: one.cost)


def _of_kind(
    kind: Steady, tracks: Tracks, world_to_camera: F64, intrinsics: F64, group: I64, huber_px: float
) -> SteadyError:
    sightings = Sightings.of(tracks, intrinsics)
    relative = world_to_camera @ np.linalg.inv(world_to_camera[tracks.reference])
    along = _along(relative, tracks.reference)
    by, prior = np.zeros(3), np.eye(3) / _PRIOR**2
    for _ in range(_STEPS):
        errors = _left(_corrected(kind, relative, along, by), sightings, huber_px)
        stepped = (
            _left(_corrected(kind, relative, along, by + _DIFFERENCE * one), sightings, huber_px) for one in np.eye(3)
        )
        slopes = np.stack([(one - errors) / _DIFFERENCE for one in stepped], axis=-1)
        distance = np.linalg.norm(errors, axis=-1)
        weight = sightings.seen * huber_px / np.maximum(distance, huber_px)
        # Two coordinates for each sighting, less the place of each point and its depth.
        freedom = max(float(np.maximum(2 * sightings.seen.sum(axis=0) - 3, 0).sum()), 1.0)
        power = max(float((weight * distance**2).sum()) / freedom, np.finfo(np.float32).tiny)
        pull = np.einsum("npik,np,npi->pk", slopes, weight, errors) / power
        known = np.einsum("npik,np,npil->kl", slopes, weight, slopes) / power + prior
        by = by - np.linalg.solve(known, pull.sum(axis=0) + prior @ by)
    inverse = np.linalg.inv(known)
    of_cells = np.stack([pull[group == one].sum(axis=0) for one in np.unique(group)])
    covariance = _SHARED * (inverse + inverse @ (of_cells.T @ of_cells) @ inverse)
    variances, ways = np.linalg.eigh(covariance)
    shares = by @ ways
    told = np.square(shares) > _TOLD**2 * variances
    is_clear = bool(told.any() and (np.square(shares) / variances).sum() > _CLEAR)
    by = ways[:, told] @ shares[told]
    corrected = _corrected(kind, relative, along, by)
    left = np.linalg.norm(_left(corrected, sightings, huber_px), axis=-1)
    cost = np.where(left < huber_px, left**2 / 2, huber_px * (left - huber_px / 2)).sum()
    turned = float(np.sqrt(np.square(along - along.mean()).mean())) if kind == Steady.TURN else 0.0
    return SteadyError(kind, by, covariance, is_clear, corrected, turned, float(cost))


def _along(relative: F64, reference: int) -> F64:
    """Return how far each view is along the path, as a share of it, counted from the reference, [N]."""
    steps = np.linalg.norm(np.diff(camera_centres(relative), axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)]) / max(float(steps.sum()), np.finfo(np.float64).tiny)
    return np.asarray(along - along[reference])


def _corrected(kind: Steady, relative: F64, along: F64, by: F64) -> F64:
    """Return poses with another turn in step with the travel about the same centres, or another direction of travel."""
    poses, centres = relative.copy(), camera_centres(relative)
    if kind == Steady.TURN:
        poses[:, :3, :3] = Rotation.from_rotvec(along[:, None] * by).as_matrix() @ poses[:, :3, :3]
    else:
        centres = Rotation.from_rotvec(by).apply(centres)
    poses[:, :3, 3] = -np.einsum("nij,nj->ni", poses[:, :3, :3], centres)
    return poses


def _left(poses: F64, sightings: Sightings, huber_px: float) -> F64:
    """Return what poses leave of tracks, [N, P, 2] px, beyond what the place and the depth of each point explain."""
    rotations, translations = poses[:, :3, :3], poses[:, :3, 3]
    inverse_depth = triangulate(rotations, translations, sightings, huber_px)
    points = sightings.rays @ rotations.transpose(0, 2, 1) + translations[:, None] * inverse_depth[None, :, None]
    depth = np.maximum(points[..., 2:], LEAST_RELATIVE_DEPTH)
    places = points[..., :2] / depth
    errors = (places - sightings.seen_at) * sightings.focal_px
    by_depth = (translations[:, None, :2] - places * translations[:, None, 2:]) / depth * sightings.focal_px
    seen = sightings.seen[..., None]
    count = np.maximum(seen.sum(axis=0), 1)
    errors, by_depth = (seen * (one - (seen * one).sum(axis=0) / count) for one in (errors, by_depth))
    power = np.maximum(np.square(by_depth).sum(axis=(0, 2)), np.finfo(np.float64).tiny)
    share = (errors * by_depth).sum(axis=(0, 2)) / power
    found: F64 = errors - share[None, :, None] * by_depth
    return found
