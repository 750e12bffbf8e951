"""Small-motion bundle adjustment: camera poses and one inverse depth per track, from nothing but the tracks.

Here: the model, its analytic Jacobian, and the robust Levenberg-Marquardt loop (float64). Not here: what the result is
worth (`validity`), the focal length (`focal`). Only `gs2ci.reconstruct.geometry` imports this file.

The camera moves little during one exposure. So every pose may start at the identity and every inverse depth at one,
and no pair of views has to be found to begin with (Yu and Gallup 2014). Each point lies on the ray of its corner in
the reference view, which takes away two of its three unknowns:

    X = R ray + t ρ        (times 1/ρ: a point at infinity is a number like any other)
    r = f (X_xy / X_z − x)
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gs2ci.reconstruct.geometry.tracks import Tracks

F64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

# Depth relative to the reference ray below which a point counts as behind the camera; also keeps X_z off zero.
_LEAST_RELATIVE_DEPTH = 1e-3
# Inverse depths stay within this range of their common scale 1: farther is infinity, nearer is the lens.
INVERSE_DEPTH_RANGE = (0.02, 20.0)
# A spread of starting depths, as with all equal no translation could be told from a rotation.
_START_SPREAD = 0.05
_DAMPING_START, _DAMPING_LEAST, _DAMPING_MOST = 1e-3, 1e-8, 1e8
# Keeps the normal equations of a view without tracks, or of a point without parallax, solvable; far below any of
# their true entries, which count pixels squared.
_REGULAR = 1e-9
# Rotations of some degrees converge quadratically; ten steps are ample.
_ROTATION_STEPS = 10


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


@dataclass(frozen=True)
class Motion:
    """Poses and depths that explain tracks.

    Args:
        rotations: Reference to view, [N, 3, 3]; the identity for the reference view.
        translations: [N, 3]; zero for the reference view. The unit is that of 1 / inverse depth.
        inverse_depth: Of each track on its reference ray, [P].
        errors_px: Prediction minus track, [P, N, 2]; NaN where a view does not see the point.
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
    def residuals_px(self) -> F64:
        """Get the distance between prediction and track, [P, N]; NaN where a view does not see the point."""
        return np.linalg.norm(self.errors_px, axis=-1)

    @property
    def world_to_camera(self) -> F64:
        """Get the poses, [N, 4, 4], with the reference view as the world."""
        poses = np.tile(np.eye(4), (len(self.rotations), 1, 1))
        poses[:, :3, :3] = self.rotations
        poses[:, :3, 3] = self.translations
        return poses

    @property
    def behind_share(self) -> float:
        """Get the share of tracks that some view has at or behind its camera."""
        return float(np.mean(self.least_depth <= _LEAST_RELATIVE_DEPTH)) if len(self.least_depth) else 0.0

    @property
    def rms_px(self) -> float:
        """Get the root mean square residual over all sightings but those of the reference view, in px."""
        seen = ~np.isnan(self.residuals_px)
        return float(np.sqrt(np.mean(self.residuals_px[seen] ** 2))) if seen.any() else 0.0


@dataclass(frozen=True)
class Rotations:
    """Poses of a camera that only turned, and what they leave unexplained.

    Args:
        rotations: Reference to view, [N, 3, 3].
        errors_px: Prediction minus track, [P, N, 2]; NaN where a view does not see the point.
    """

    rotations: F64
    errors_px: F64


def wander_px(errors_px: F64) -> float:
    """Get by how much errors vary along each track, per degree of freedom, root mean square.

    A corner that is misplaced in the reference view shifts its errors in all other views alike. Such a shift says
    nothing about the motion, and a translation explains one component of it for nothing: so it is taken out.

    Args:
        errors_px: [P, N, 2]; NaN where a view does not see the point.
    """
    seen = ~np.isnan(errors_px[..., 0])
    spare = int(seen.sum()) - int(seen.any(axis=1).sum())
    if spare < 1:
        return 0.0
    errors = np.where(seen[..., None], errors_px, 0.0)
    mean = errors.sum(axis=1) / np.maximum(seen.sum(axis=1), 1)[:, None]
    variation = (errors - mean[:, None]) * seen[..., None]
    return float(np.sqrt((variation**2).sum() / spare))


@dataclass(frozen=True)
class Sightings:
    """Tracks in camera units, ready for adjustment, views first.

    Args:
        rays: Directions of the points in the reference view, [P, 3], third component 1.
        seen_at: Where each view sees them, [N, P, 2], in units of the focal length; 0 where not seen.
        seen: [N, P]; False for the reference view, which the rays fulfil by construction.
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
        """Take tracks through the inverse of a camera matrix, [3, 3]."""
        focal = np.array([intrinsics[0, 0], intrinsics[1, 1]])
        normalised = (tracks.positions - intrinsics[:2, 2]) / focal
        rays = np.concatenate([normalised[:, tracks.reference], np.ones((len(tracks), 1))], axis=1)
        seen = tracks.seen.T.copy()
        seen[tracks.reference] = False
        return cls(rays, np.nan_to_num(normalised.transpose(1, 0, 2)), seen, focal, tracks.reference)


def start_motion(sightings: Sightings, seed: int = 0) -> Motion:
    """Begin with a camera that does not move and a nearly flat scene at inverse depth one."""
    views, points = sightings.seen.shape
    spread = np.random.default_rng(seed).standard_normal(points)
    return Motion(
        rotations=np.tile(np.eye(3), (views, 1, 1)),
        translations=np.zeros((views, 3)),
        inverse_depth=1 + _START_SPREAD * spread,
        errors_px=np.full((points, views, 2), np.nan),
        least_depth=np.ones(points),
        cost=np.inf,
    )


def residuals(motion: Motion, sightings: Sightings) -> tuple[F64, F64]:
    """Predict where each view sees each point.

    Returns:
        Prediction minus sighting in px, [N, P, 2], and the points in camera axes times their inverse depth, [N, P, 3].
    """
    turned = sightings.rays @ motion.rotations.transpose(0, 2, 1)
    points = turned + motion.translations[:, None] * motion.inverse_depth[None, :, None]
    depth = np.maximum(points[..., 2:], _LEAST_RELATIVE_DEPTH)
    return (points[..., :2] / depth - sightings.seen_at) * sightings.focal_px, points


def jacobians(motion: Motion, sightings: Sightings, points: F64) -> tuple[F64, F64]:
    """Differentiate the residuals.

    Args:
        motion: Where to differentiate.
        sightings: The tracks.
        points: Second result of `residuals` there.

    Returns:
        d r / d (ω, t), [N, P, 2, 6], for R ← exp(ω) R; and d r / d ρ, [N, P, 2].
    """
    fx, fy = sightings.focal_px
    inverse_z = 1 / np.maximum(points[..., 2], _LEAST_RELATIVE_DEPTH)
    by_point = np.zeros((*points.shape[:2], 2, 3))
    by_point[..., 0, 0] = fx * inverse_z
    by_point[..., 1, 1] = fy * inverse_z
    by_point[..., 0, 2] = -fx * points[..., 0] * inverse_z**2
    by_point[..., 1, 2] = -fy * points[..., 1] * inverse_z**2
    turned = points - motion.translations[:, None] * motion.inverse_depth[None, :, None]
    by_pose = np.empty((*points.shape[:2], 2, 6))
    # d(exp(ω) v)/dω = −[v]×, and row · −[v]× = v × row.
    by_pose[..., :3] = np.cross(turned[:, :, None], by_point)
    by_pose[..., 3:] = by_point * motion.inverse_depth[None, :, None, None]
    by_depth = np.einsum("npij,nj->npi", by_point, motion.translations)
    return by_pose, by_depth


def adjust(
    tracks: Tracks, intrinsics: F64, settings: MotionSettings | None = None, start: Motion | None = None
) -> Motion:
    """Find the poses and inverse depths that explain all tracks best.

    Args:
        tracks: At least one point.
        intrinsics: Camera matrix in px, [3, 3].
        settings: How to adjust.
        start: Where to begin; None for a still camera before a flat scene.

    Returns:
        A minimum of the Huber cost, at whatever scale it was reached.

    Levenberg-Marquardt on re-weighted least squares, inverse depths eliminated by the Schur complement. The scale of
    the scene is free; the damping holds it.
    """
    settings = settings or MotionSettings()
    sightings = Sightings.of(tracks, intrinsics)
    motion = start or start_motion(sightings)
    error, points = residuals(motion, sightings)
    motion = replace(motion, cost=_huber_cost(error, sightings.seen, settings.huber_px))
    damping = _DAMPING_START
    for _ in range(settings.iterations):
        system = _NormalEquations.at(motion, sightings, error, points, settings.huber_px)
        before = motion.cost
        while damping < _DAMPING_MOST:
            trial = system.step(motion, damping)
            error, points = residuals(trial, sightings)
            trial = replace(trial, cost=_huber_cost(error, sightings.seen, settings.huber_px))
            if trial.cost < motion.cost:
                motion, damping = trial, max(damping / 3, _DAMPING_LEAST)
                break
            damping *= 4
        if before - motion.cost <= settings.tolerance * before:
            break
    return _with_residuals(motion, sightings)


def estimate_motion(tracks: Tracks, intrinsics: F64, settings: MotionSettings | None = None) -> tuple[Motion, Tracks]:
    """Adjust, drop the tracks that the motion does not explain, and adjust the rest from the start.

    Args:
        tracks: At least one point.
        intrinsics: Camera matrix in px, [3, 3].
        settings: How to adjust.

    Returns:
        The motion and the tracks that it explains, with inverse depths of median 1.
    """
    settings = settings or MotionSettings()
    first = adjust(tracks, intrinsics, settings)
    explained = np.nanmax(first.residuals_px, axis=1, initial=0) < settings.outlier_px
    if not explained.any():
        return first, tracks
    kept = tracks.keep(explained)
    motion = adjust(kept, intrinsics, settings)
    scale = float(np.median(motion.inverse_depth))
    scaled = replace(motion, translations=motion.translations * scale, inverse_depth=motion.inverse_depth / scale)
    return scaled, kept


def fit_rotations(tracks: Tracks, intrinsics: F64, settings: MotionSettings | None = None) -> Rotations:
    """Find the pure rotations that explain all tracks best, by re-weighted Gauss-Newton for each view on its own."""
    settings = settings or MotionSettings()
    sightings = Sightings.of(tracks, intrinsics)
    motion = start_motion(sightings)
    for _ in range(_ROTATION_STEPS):
        error, points = residuals(motion, sightings)
        distance = np.linalg.norm(error, axis=-1)
        weight = np.where(
            distance < settings.huber_px, 1.0, settings.huber_px / np.maximum(distance, settings.huber_px)
        )
        jacobian = jacobians(motion, sightings, points)[0][..., :3]
        weighted = jacobian * (weight * sightings.seen)[..., None, None]
        normal = np.einsum("npai,npaj->nij", weighted, jacobian) + _REGULAR * np.eye(3)
        turn = -np.linalg.solve(normal, np.einsum("npai,npa->ni", weighted, error)[..., None])[..., 0]
        motion = replace(motion, rotations=Rotation.from_rotvec(turn).as_matrix() @ motion.rotations)
    return Rotations(motion.rotations, _with_residuals(motion, sightings).errors_px)


def _with_residuals(motion: Motion, sightings: Sightings) -> Motion:
    error, points = residuals(motion, sightings)
    return replace(
        motion,
        errors_px=np.where(sightings.seen[..., None], error, np.nan).transpose(1, 0, 2),
        least_depth=np.where(sightings.seen, points[..., 2], 1.0).min(0),
    )


def _huber_cost(error: F64, seen: Bool, huber_px: float) -> float:
    distance = np.linalg.norm(error, axis=-1)
    cost = np.where(distance < huber_px, 0.5 * distance**2, huber_px * (distance - 0.5 * huber_px))
    return float((cost * seen).sum())


@dataclass(frozen=True)
class _NormalEquations:
    """JᵀWJ and −JᵀWr in blocks: A for poses, C for inverse depths, E between them."""

    A: F64  # [N, 6, 6]
    b: F64  # [N, 6]
    C: F64  # [P]
    d: F64  # [P]
    E: F64  # [P, 6 N]
    moving: F64  # indices of the unknowns of all views but the reference

    @classmethod
    def at(cls, motion: Motion, sightings: Sightings, error: F64, points: F64, huber_px: float) -> "_NormalEquations":
        by_pose, by_depth = jacobians(motion, sightings, points)
        distance = np.linalg.norm(error, axis=-1)
        root = np.sqrt(np.where(distance < huber_px, 1.0, huber_px / np.maximum(distance, huber_px)) * sightings.seen)
        views, count = root.shape
        Jp = (by_pose * root[..., None, None]).reshape(views, 2 * count, 6)
        Jd, r = by_depth * root[..., None], error * root[..., None]
        transposed = Jp.transpose(0, 2, 1)
        E = (Jp.reshape(views, count, 2, 6) * Jd[..., None]).sum(2)
        return cls(
            A=transposed @ Jp,
            b=-(transposed @ r.reshape(views, -1, 1))[..., 0],
            C=(Jd**2).sum((0, 2)),
            d=-(Jd * r).sum((0, 2)),
            E=E.transpose(1, 0, 2).reshape(count, 6 * views),
            moving=np.flatnonzero(np.arange(6 * views) // 6 != sightings.reference),
        )

    def step(self, motion: Motion, damping: float) -> Motion:
        """Solve with damping and move; inverse depths stay within their range."""
        views = len(self.A)
        C = self.C * (1 + damping) + _REGULAR
        system = -self.E.T @ (self.E / C[:, None])
        for i in range(views):
            block = slice(6 * i, 6 * i + 6)
            system[block, block] += self.A[i] + np.diag(damping * np.diag(self.A[i]) + _REGULAR)
        right = self.b.reshape(-1) - self.E.T @ (self.d / C)
        pose_step = np.zeros(6 * views)
        pose_step[self.moving] = np.linalg.solve(system[np.ix_(self.moving, self.moving)], right[self.moving])
        depth_step = (self.d - self.E @ pose_step) / C
        pose_step = pose_step.reshape(views, 6)
        return replace(
            motion,
            rotations=Rotation.from_rotvec(pose_step[:, :3]).as_matrix() @ motion.rotations,
            translations=motion.translations + pose_step[:, 3:],
            inverse_depth=np.clip(motion.inverse_depth + depth_step, *INVERSE_DEPTH_RANGE),
        )
