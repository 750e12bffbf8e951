"""A turn in step with the travel that given poses lack or invent: three numbers, which all tracks together tell.

A stage reports positions. That its camera turns on the way moves a picture nearly as another depth does: all inverse
depths alike, and only beyond that by the square of the field of view. So nothing but the turn from the first view to
the last is asked for. The depth of each point and its place in the reference view are eliminated, since they are not
known. Here: the turn with its error, and the poses corrected by it. Not here: whether given poses are contradicted
(`halves`), what is done about it (`sources.sources`), another direction of travel, which tracks take for a turn and
the other way round.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import camera_centres
from gs2ci.reconstruct.geometry.path.adjustment_kernels import LEAST_RELATIVE_DEPTH
from gs2ci.reconstruct.geometry.path.halves import cells
from gs2ci.reconstruct.geometry.path.motion import Sightings
from gs2ci.reconstruct.geometry.path.telemetry import triangulate
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks

# What is known of a turn beforehand, rad: keeps what tracks do not tell near zero.
_PRIOR: Final = 0.2
# Gauss-Newton on a few numbers that are nearly linear; derivatives by differences of so much, rad.
_STEPS, _DIFFERENCE = 5, 1e-4
# The errors of tracks are those of one decode: neighbours share them, and some are shared by all. Variances are so many
# times what the residuals and their sums over cells of the picture say together: exact poses of 75 draws then leave
# the median of the squared distance of three numbers.
_SHARED: Final = 3.0
# A combination of the three numbers is there if it is so many standard errors from zero; otherwise the poses stand.
_TOLD: Final = 3.5
_LEAST: Final = float(np.finfo(np.float32).tiny)  # of squares of px, so that tracks without an error divide


@dataclass(frozen=True)
class Turning:
    """A turn that given poses lack, as tracks show it.

    Args:
        by: From the first view to the last, as a rotation vector in the axes of the reference camera, rad, [3]. What
            tracks do not tell of it is zero.
        error: Standard error in the direction that is least sure, rad.
        world_to_camera: The given poses with it, [N, 4, 4]; the identity for the reference view.
    """

    by: F64
    error: float
    world_to_camera: F64


def turning(tracks: Tracks, world_to_camera: F64, intrinsics: F64, size: tuple[int, int], huber_px: float) -> Turning:
    """Find the turn in step with the travel of given poses that explains tracks best.

    Args:
        tracks: At least one point.
        world_to_camera: Given poses of a camera that moves, [N, 4, 4], in any frame and unit.
        intrinsics: Camera matrix in px, [3, 3].
        size: Height and width of the views, px.
        huber_px: Residual from which on an observation counts less.
    """
    sightings, group = Sightings.of(tracks, intrinsics), cells(tracks, size)
    relative = world_to_camera @ np.linalg.inv(world_to_camera[tracks.reference])
    centres = camera_centres(relative)
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)]) / max(float(steps.sum()), _LEAST)
    along -= along[tracks.reference]

    def turned(by: F64) -> F64:
        poses = relative.copy()
        poses[:, :3, :3] = Rotation.from_rotvec(along[:, None] * by).as_matrix() @ relative[:, :3, :3]
        poses[:, :3, 3] = -np.einsum("nij,nj->ni", poses[:, :3, :3], centres)
        return poses

    by, prior = np.zeros(3), np.eye(3) / _PRIOR**2
    # Two coordinates for each sighting, less the place of each point and its depth.
    freedom = max(float(np.maximum(2 * sightings.seen.sum(axis=0) - 3, 0).sum()), 1.0)
    for _ in range(_STEPS):
        errors = _left(turned(by), sightings, huber_px)
        more = (_left(turned(by + _DIFFERENCE * one), sightings, huber_px) for one in np.eye(3))
        slopes = np.stack([(one - errors) / _DIFFERENCE for one in more], axis=-1)
        distance = np.linalg.norm(errors, axis=-1)
        weight = sightings.seen * huber_px / np.maximum(distance, huber_px)
        power = max(float((weight * distance**2).sum()) / freedom, _LEAST)
        pull = np.einsum("npik,np,npi->pk", slopes, weight, errors) / power
        known = np.einsum("npik,np,npil->kl", slopes, weight, slopes) / power + prior
        by = by - np.linalg.solve(known, pull.sum(axis=0) + prior @ by)
    inverse = np.linalg.inv(known)
    of_cells = inverse @ np.stack([pull[group == one].sum(axis=0) for one in np.unique(group)], axis=1)
    variances, ways = np.linalg.eigh(_SHARED * (inverse + of_cells @ of_cells.T))
    shares = by @ ways
    by = ways @ np.where(np.abs(shares) > _TOLD * np.sqrt(variances), shares, 0.0)
    return Turning(by, float(variances[-1]) ** 0.5, turned(by))


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
