"""Small-motion bundle adjustment: camera poses and one inverse depth per track, from tracks alone.

Here: the model, and adjustments from several starts. Not here: its derivatives and the Levenberg-Marquardt loop
(`adjustment_kernels`), the judgement of the result (`validity`), the focal length (`focal`), a camera that only turned
(`rotations`), known poses (`telemetry`).

The camera moves little during one exposure. So every pose may start at the identity and every inverse depth at one,
without an initial pair of views (Yu and Gallup 2014). Each point lies on the ray of its corner in the reference view,
which removes two of its three unknowns:

    X = R ray + t ρ        (times 1/ρ: a point at infinity is a number like any other)
    r = f (X_xy / X_z − x)
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64, Bool
from gs2ci.core.cameras import rigid
from gs2ci.reconstruct.geometry.path.adjustment_kernels import (
    INVERSE_DEPTH_RANGE,
    LEAST_RELATIVE_DEPTH,
    descend,
)
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks

# Spread of the starting depths: if all were equal, translations could not be told from rotations.
_START_SPREAD = 0.05


@dataclass(frozen=True)
class MotionSettings:
    """How to adjust.

    Args:
        iterations: At most so many accepted steps.
        huber_px: Residual from which on the cost grows linearly.
        outlier_px: Tracks with a larger residual in any view are dropped before the second pass.
        tolerance: Relative decrease of the cost below which the adjustment has converged.
    """

    iterations: int = 60
    huber_px: float = 1.0
    outlier_px: float = 3.0
    tolerance: float = 1e-6


USUAL_MOTION: Final = MotionSettings()


@dataclass(frozen=True)
class CameraMotion:
    """Poses and depths that explain tracks.

    Args:
        rotations: Reference to view, [N, 3, 3]; the identity for the reference view.
        translations: [N, 3]; zero for the reference view. The unit is that of 1 / inverse depth.
        inverse_depth: Of each track on its reference ray, [P].
        errors_px: Prediction minus track, [P, N, 2]; NaN in the reference view and where a view does not see the
            point.
        least_depth: Smallest depth of each point over the views that see it, relative to its depth in the reference
            view, [P].
        cost: Sum of Huber costs in px².
    """

    rotations: F64
    translations: F64
    inverse_depth: F64
    errors_px: F64
    least_depth: F64
    cost: float

    @property
    def world_to_camera(self) -> F64:
        """Get the poses, [N, 4, 4], with the reference view as the world."""
        return rigid(self.rotations, self.translations)

    @property
    def residuals_px(self) -> F64:
        """Get the distance between prediction and track, [P, N]; NaN as in `errors_px`."""
        return np.linalg.norm(self.errors_px, axis=-1)

    @property
    def behind_share(self) -> float:
        """Get the share of tracks that lie at or behind the camera of some view."""
        return float(np.mean(self.least_depth <= LEAST_RELATIVE_DEPTH)) if len(self.least_depth) else 0.0

    def explains(self, outlier_px: float) -> Bool:
        """Tell which tracks, [P], it explains: those with smaller residuals in all views."""
        return np.nanmax(self.residuals_px, axis=1, initial=0) < outlier_px

    @property
    def rms_px(self) -> float:
        """Get the root mean square residual over all observations but those of the reference view, in px."""
        return rms_px(self.errors_px)


def rms_px(errors_px: F64) -> float:
    """Get the root mean square length of errors, [..., 2], without NaN; 0 if there is no error."""
    squares = (errors_px**2).sum(axis=-1)
    seen = ~np.isnan(squares)
    return float(np.sqrt(squares[seen].mean())) if seen.any() else 0.0


def predict_positions(positions_px: F64, inverse_depth: F64, world_to_camera: F64, intrinsics: F64) -> F64:
    """Predict the positions, in every view, of points of the reference view.

    Args:
        positions_px: Their pixels in the reference view, [P, 2].
        inverse_depth: [P].
        world_to_camera: [N, 4, 4], the identity for the reference view.
        intrinsics: Camera matrix in px, [3, 3].

    Returns:
        [P, N, 2] px.
    """
    turned = rays(positions_px, intrinsics) @ world_to_camera[:, :3, :3].transpose(0, 2, 1)
    points = (turned + world_to_camera[:, None, :3, 3] * inverse_depth[None, :, None]) @ intrinsics.T
    pixels: F64 = points[..., :2] / np.maximum(points[..., 2:], LEAST_RELATIVE_DEPTH)
    return pixels.transpose(1, 0, 2)


def rays(positions_px: F64, intrinsics: F64) -> F64:
    """Turn pixels, [P, 2], into directions with third component 1, [P, 3]."""
    homogeneous = np.concatenate([positions_px, np.ones((len(positions_px), 1))], axis=1)
    return homogeneous @ np.linalg.inv(intrinsics).T


def wander_px(errors_px: F64, unknowns: int = 0) -> float:
    """Get the variation of errors along each track, per degree of freedom, root mean square length.

    A misplaced corner in the reference view shifts its errors in all other views alike. Such a shift carries no
    information on the motion, and any translation explains one component of it; so it is subtracted.

    Args:
        errors_px: [P, N, 2]; NaN if a view does not see the point. Tracks with one observation are not used.
        unknowns: How many were fitted to each track.

    Returns:
        0 if no degree of freedom is left.
    """
    seen = ~np.isnan(errors_px[..., 0])
    sightings = seen.sum(axis=1)
    # Two coordinates for each observation, minus the two of the mean.
    freedom = int((2 * (sightings - 1) - unknowns)[sightings > 1].sum())
    if freedom < 1:
        return 0.0
    errors = np.where(seen[..., None], errors_px, 0.0)
    mean = errors.sum(axis=1) / np.maximum(sightings, 1)[:, None]
    variation = (errors - mean[:, None]) * seen[..., None]
    return float(np.sqrt(2 * (variation**2).sum() / freedom))


@dataclass(frozen=True)
class Sightings:
    """Tracks in camera units, ready for adjustment, views first.

    Args:
        rays: Directions of the points in the reference view, [P, 3], third component 1.
        seen_at: Positions in each view, [N, P, 2], in units of the focal length; 0 if not seen.
        seen: [N, P]; False for the reference view, whose positions the rays meet by construction.
        focal_px: fx and fy, [2].
        reference: Index of the reference view.
    """

    rays: F64
    seen_at: F64
    seen: Bool
    focal_px: F64
    reference: int

    @classmethod
    def of(cls, tracks: Tracks, intrinsics: F64) -> "Sightings":
        """Convert tracks by the inverse of a camera matrix, [3, 3]."""
        focal = np.array([intrinsics[0, 0], intrinsics[1, 1]])
        normalised = (tracks.positions - intrinsics[:2, 2]) / focal
        directions = rays(tracks.positions[:, tracks.reference], intrinsics)
        seen = np.ascontiguousarray(tracks.seen.T)
        seen[tracks.reference] = False
        return cls(
            directions,
            np.ascontiguousarray(np.nan_to_num(normalised.transpose(1, 0, 2))),
            seen,
            focal,
            tracks.reference,
        )


def start_motion(sightings: Sightings) -> CameraMotion:
    """Return the start: a camera that does not move and a nearly flat scene at inverse depth one."""
    views, points = sightings.seen.shape
    spread = np.random.default_rng(0).standard_normal(points)
    return CameraMotion(
        rotations=np.tile(np.eye(3), (views, 1, 1)),
        translations=np.zeros((views, 3)),
        inverse_depth=np.asarray(1 + _START_SPREAD * spread),
        errors_px=np.full((points, views, 2), np.nan),
        least_depth=np.ones(points),
        cost=np.inf,
    )


def residuals(motion: CameraMotion, sightings: Sightings) -> tuple[F64, F64]:
    """Predict the position of each point in each view, and compare it with the observed one.

    Returns:
        Prediction minus observation, px, [N, P, 2], and the points in camera axes times their inverse depth, [N, P, 3].
    """
    turned = sightings.rays @ motion.rotations.transpose(0, 2, 1)
    points = turned + motion.translations[:, None] * motion.inverse_depth[None, :, None]
    depth = np.maximum(points[..., 2:], LEAST_RELATIVE_DEPTH)
    return (points[..., :2] / depth - sightings.seen_at) * sightings.focal_px, points


def adjust(
    tracks: Tracks, intrinsics: F64, settings: MotionSettings = USUAL_MOTION, start: CameraMotion | None = None
) -> CameraMotion:
    """Find the poses and inverse depths that explain all tracks best.

    Args:
        tracks: At least one point.
        intrinsics: Camera matrix in px, [3, 3].
        settings: How to adjust.
        start: Where to start; None for a still camera in front of a flat scene.

    Returns:
        A minimum of the Huber cost, at an arbitrary scale.

    Levenberg-Marquardt on re-weighted least squares, inverse depths eliminated by the Schur complement. The scale of
    the scene is free; the damping keeps it bounded.
    """
    sightings = Sightings.of(tracks, intrinsics)
    motion = start or start_motion(sightings)
    how = (settings.huber_px, settings.iterations, settings.tolerance)
    rotations, translations, inverse_depth, cost = descend(*arguments(motion, sightings), *how)
    found = replace(motion, rotations=rotations, translations=translations, inverse_depth=inverse_depth, cost=cost)
    return with_errors(found, sightings)


def reversed_depth(motion: CameraMotion) -> CameraMotion:
    """Reverse the order of depth (near and far exchanged), with the motion that looks the same to a distant camera.

    Inverse depths ρ become c − ρ with c twice their median, translations t become −t, and rotations compensate the
    difference: f (ω + t ρ) = f (ω + c t − t (c − ρ)) to first order (the Necker reversal).
    """
    c = 2 * float(np.median(motion.inverse_depth))
    poses = reversed_poses(motion.world_to_camera, c)
    return replace(
        motion,
        rotations=poses[:, :3, :3],
        translations=poses[:, :3, 3],
        inverse_depth=np.clip(c - motion.inverse_depth, *INVERSE_DEPTH_RANGE),
    )


def reversed_poses(world_to_camera: F64, c: float) -> F64:
    """Return the path, [N, 4, 4], from which inverse depths c − ρ move in the picture as ρ do from the given path."""
    poses, t = world_to_camera.copy(), world_to_camera[:, :3, 3]
    turns = Rotation.from_rotvec(c * np.stack([-t[:, 1], t[:, 0], np.zeros(len(t))], axis=1)).as_matrix()
    poses[:, :3, :3] = turns @ poses[:, :3, :3]
    poses[:, :3, 3] = -t
    return poses


def adjust_both_ways(tracks: Tracks, intrinsics: F64, settings: MotionSettings = USUAL_MOTION) -> CameraMotion:
    """Adjust from a still camera, then from the depth-reversed result, and keep the better; arguments as for `adjust`.

    The cost has a minimum near each; a flat start may lead to the wrong one.
    """
    here = adjust(tracks, intrinsics, settings)
    there = adjust(tracks, intrinsics, settings, start=reversed_depth(here))
    return min(here, there, key=lambda motion: motion.cost)


def preference(motion: CameraMotion, other: CameraMotion, huber_px: float) -> float:
    """Return by how many standard errors tracks prefer one motion to another; above 0 if they prefer the first.

    Each track has a vote, the difference of its Huber costs. The standard error does not include errors that tracks
    share, those of the middle view, of the camera model and of occluding edges: wrong orders of depth were preferred by
    3 and 4 standard errors.

    Args:
        motion: With its errors.
        other: With its errors on the same tracks.
        huber_px: Residual from which on the cost grows linearly.
    """
    return in_standard_errors(_costs(other, huber_px) - _costs(motion, huber_px))


def in_standard_errors(votes: F64) -> float:
    """Return the mean of votes, [P], in its standard errors; 0 if there are none, or the votes are all alike."""
    if len(votes) < 2:
        return 0.0
    error = float(votes.std(ddof=1)) / len(votes) ** 0.5
    return float(votes.mean()) / error if error > 0 else 0.0


def _costs(motion: CameraMotion, huber_px: float) -> F64:
    """Get the Huber cost of each track, [P] px²."""
    distance = np.nan_to_num(motion.residuals_px)
    return np.where(distance <= huber_px, distance**2, 2 * huber_px * distance - huber_px**2).sum(axis=1)


def estimate_motion(
    tracks: Tracks, intrinsics: F64, settings: MotionSettings = USUAL_MOTION
) -> tuple[CameraMotion, Tracks]:
    """Adjust, drop the tracks that the motion does not explain, and adjust to the rest again.

    Args:
        tracks: At least one point.
        intrinsics: Camera matrix in px, [3, 3].
        settings: How to adjust.

    Returns:
        The motion and the tracks that it explains, with inverse depths of median 1.
    """
    first = adjust_both_ways(tracks, intrinsics, settings)
    explained = first.explains(settings.outlier_px)
    if not explained.any():
        return first, tracks
    if explained.all():
        return at_unit_depth(first), tracks
    kept = tracks.keep(explained)
    return at_unit_depth(adjust_both_ways(kept, intrinsics, settings)), kept


def at_unit_depth(motion: CameraMotion) -> CameraMotion:
    """Return the motion at the scale at which the median of the inverse depths is 1."""
    scale = float(np.median(motion.inverse_depth))
    return replace(motion, translations=motion.translations * scale, inverse_depth=motion.inverse_depth / scale)


def with_errors(motion: CameraMotion, sightings: Sightings) -> CameraMotion:
    """Return the motion with the errors and depths that it has on these tracks."""
    error, points = residuals(motion, sightings)
    return replace(
        motion,
        errors_px=np.where(sightings.seen[..., None], error, np.nan).transpose(1, 0, 2),
        least_depth=np.where(sightings.seen, points[..., 2], 1.0).min(0),
    )


def arguments(motion: CameraMotion, sightings: Sightings) -> tuple[F64, F64, F64, F64, F64, Bool, F64]:
    """Return the arguments in the order of the kernels."""
    return (
        np.ascontiguousarray(motion.rotations),
        np.ascontiguousarray(motion.translations),
        motion.inverse_depth,
        sightings.rays,
        sightings.seen_at,
        sightings.seen,
        sightings.focal_px,
    )
