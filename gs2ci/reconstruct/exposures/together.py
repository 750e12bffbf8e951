"""Similarities of all exposures at once, from corners followed between them, whose depths are found anew.

Depth maps of single exposures, each over a baseline of some pixels, are distorted: inverse depths are off by a constant
and stretched by 0.6 to 1.5 times, which a small motion cannot tell from a turn of the camera. Similarities of pairs
that rely on them are off by several pixels. A corner that several exposures see has a far better depth. So it lies
anywhere on its ray in the picture that it was found in, and the depth map says only roughly where:

    X = S_h (camera + e^λ (point − camera)),    r = (project(S_a⁻¹ X) − place) / 0.7 px,    λ / 0.3

Here: the model and its robust Levenberg-Marquardt loop, depths eliminated. Not here: corners (`corners`), what follows
for paths and depth maps (`refined`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64, I64
from gs2ci.reconstruct.exposures.pairs import PLACE_ERROR_PX, projected
from gs2ci.reconstruct.exposures.similarity import CHANGES, Similarity

_DEPTH_ERROR: Final = 0.3
# Squared distances in standard errors beyond this count less and less.
_CAUCHY: Final = 4.0
_STEPS: Final = 60
_SETTLED: Final = 1e-6
_DAMPING: Final = (1e-3, 1e-9, 1e9)
_DAMPING_FACTOR: Final = 5.0
_LONGEST_STEP: Final = 0.5
_STRETCH_LIMIT: Final = 2.0


@dataclass(frozen=True, eq=False)
class Corners:
    """Corners, and where exposures see them.

    Args:
        points: In the coordinates of the exposure that each was found in (its host), by its depth map, [P, 3].
        hosts: Index of that exposure, [P].
        cameras: Centre of the camera of its picture, in the same coordinates, [P, 3].
        of: Which corner is seen, [M].
        by: By which exposure, [M].
        poses: World-to-camera of the picture, in that exposure's coordinates, [M, 4, 4].
        intrinsics: Of the picture, [M, 3, 3].
        places: Where, [M, 2] px.
    """

    points: F64
    hosts: I64
    cameras: F64
    of: I64
    by: I64
    poses: F64
    intrinsics: F64
    places: F64


@dataclass(frozen=True, eq=False)
class Adjusted:
    """Similarities adjusted together.

    Args:
        similarities: common_from_own of each exposure.
        stretches: How many times as far from their camera as their depth maps say corners lie, [P].
        distances_px: Of what is seen from where it should be, [M].
        covariance: Of the changes of all similarities but the first, about `centres` in `units`, [7 (E-1), 7 (E-1)].
    """

    similarities: tuple[Similarity, ...]
    stretches: F64
    distances_px: F64
    covariance: F64


@dataclass(frozen=True, eq=False)
class _State:
    similarities: tuple[Similarity, ...]
    logarithms: F64


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations: of changes of similarities, [7 E], and logarithms of stretches, [P]."""

    cost: float
    hessian: F64
    slope: F64
    mixed: F64
    along: F64
    along_slope: F64

    def reduced(self, damping: float) -> tuple[F64, F64, F64]:
        """Return the matrix and the slope of the changes of all but the first, and the damped diagonal of depths."""
        along = self.along * (1 + damping)
        matrix = self.hessian + damping * np.diag(np.diag(self.hessian))
        matrix = matrix - self.mixed.T @ (self.mixed / along[:, None])
        slope = self.slope - self.mixed.T @ (self.along_slope / along)
        return matrix[CHANGES:, CHANGES:], slope[CHANGES:], along

    def step(self, damping: float) -> tuple[F64, F64]:
        """Solve for the changes, [E, 7], and the logarithms, [P]."""
        matrix, slope, along = self.reduced(damping)
        changes = np.zeros(len(self.slope))
        changes[CHANGES:] = -np.linalg.lstsq(matrix, slope, rcond=1e-12)[0]
        further = -(self.along_slope + self.mixed @ changes) / along
        return changes.reshape(-1, CHANGES), further.clip(-_LONGEST_STEP, _LONGEST_STEP)


def adjusted_together(start: Sequence[Similarity], corners: Corners, centres: F64, units: F64) -> Adjusted:
    """Adjust similarities, of which the first is held, to corners.

    Args:
        start: common_from_own of each exposure.
        corners: What they see.
        centres: Of what each sees, in common coordinates, [E, 3]; turns and scales are taken about it.
        units: Its distance from the camera, [E].
    """
    state = _State(tuple(start), np.zeros(len(corners.points)))
    normal = _equations(state, corners, centres, units)
    damping, least, most = _DAMPING
    for _ in range(_STEPS):
        tried = _moved(state, normal.step(damping), centres, units)
        new = _equations(tried, corners, centres, units)
        if new.cost >= normal.cost:
            damping *= _DAMPING_FACTOR
            if damping > most:
                break
            continue
        gained, state, normal = normal.cost - new.cost, tried, new
        damping = max(damping / _DAMPING_FACTOR, least)
        if gained < _SETTLED * new.cost:
            break
    distances: F64 = np.linalg.norm(_Looked.at(state, corners).errors, axis=1) * PLACE_ERROR_PX
    covariance: F64 = np.asarray(np.linalg.pinv(normal.reduced(0.0)[0]), np.float64)
    return Adjusted(state.similarities, np.exp(state.logarithms), distances, covariance)


def _moved(state: _State, step: tuple[F64, F64], centres: F64, units: F64) -> _State:
    changed = (
        one.changed(change, one.inverse.points(centre), float(unit))
        for one, change, centre, unit in zip(state.similarities, step[0], centres, units, strict=True)
    )
    return _State(tuple(changed), (state.logarithms + step[1]).clip(-_STRETCH_LIMIT, _STRETCH_LIMIT))


@dataclass(frozen=True, eq=False)
class _Looked:
    """What is seen in a state.

    Args:
        errors: In standard errors, [M, 2].
        slopes: Their derivatives by the place of the corner in common coordinates, [M, 2, 3].
        points: Corners in common coordinates, [P, 3].
        rays: From their cameras to them, [P, 3].
    """

    errors: F64
    slopes: F64
    points: F64
    rays: F64

    @classmethod
    def at(cls, state: _State, corners: Corners) -> "_Looked":
        scales = np.array([one.scale for one in state.similarities])
        rotations = np.stack([one.rotation for one in state.similarities])
        translations = np.stack([one.translation for one in state.similarities])
        own, by = corners.hosts, corners.by
        turned, size = rotations[own], scales[own, None]
        rays = size * np.einsum("nij,nj->ni", turned, corners.points - corners.cameras)
        rays = rays * np.exp(state.logarithms)[:, None]
        points = size * np.einsum("nij,nj->ni", turned, corners.cameras) + translations[own] + rays
        inside = np.einsum("nji,nj->ni", rotations[by], points[corners.of] - translations[by]) / scales[by, None]
        places, depth = projected(inside, corners.poses, corners.intrinsics)
        camera_from_common = np.einsum("nij,nkj->nik", corners.poses[:, :3, :3], rotations[by])
        slopes = _slopes(inside, corners, depth) @ camera_from_common / scales[by, None, None]
        return cls((places - corners.places) / PLACE_ERROR_PX, slopes, points, rays)


def _slopes(inside: F64, corners: Corners, depth: F64) -> F64:
    """Return the derivatives of errors by the place of the corner in the camera's axes, [M, 2, 3]."""
    in_camera = np.einsum("nij,nj->ni", corners.poses[:, :3, :3], inside) + corners.poses[:, :3, 3]
    found = np.zeros((len(inside), 2, 3))
    found[:, [0, 1], [0, 1]] = 1
    found[:, :, 2] = -in_camera[:, :2] / depth[:, None]
    focal = corners.intrinsics[:, [0, 1], [0, 1]]
    return found * (focal / depth[:, None] / PLACE_ERROR_PX)[:, :, None]


def _equations(state: _State, corners: Corners, centres: F64, units: F64) -> _Normal:
    looked, count, host = _Looked.at(state, corners), len(state.similarities), corners.hosts[corners.of]
    square = (looked.errors**2).sum(axis=1)
    weight = 1 / (1 + square / _CAUCHY)
    rough = state.logarithms / _DEPTH_ERROR
    cost = 0.5 * _CAUCHY * float(np.log1p(square / _CAUCHY).sum()) + 0.5 * float((rough**2).sum())
    seen = looked.points[corners.of]
    along = np.einsum("nij,nj->ni", looked.slopes, looked.rays[corners.of])
    sides = (
        (host, looked.slopes @ _motion(seen, centres[host], units[host])),
        (corners.by, -looked.slopes @ _motion(seen, centres[corners.by], units[corners.by])),
    )
    blocks, slope = np.zeros((count, count, CHANGES, CHANGES)), np.zeros((count, CHANGES))
    mixed = np.zeros((len(rough), count, CHANGES))
    for of_one, one in sides:
        np.add.at(slope, of_one, np.einsum("nij,ni,n->nj", one, looked.errors, weight))
        np.add.at(mixed, (corners.of, of_one), np.einsum("nij,ni,n->nj", one, along, weight))
        for of_other, other in sides:
            np.add.at(blocks, (of_one, of_other), np.einsum("nij,nik,n->njk", one, other, weight))
    diagonal, along_slope = np.full(len(rough), _DEPTH_ERROR**-2), rough / _DEPTH_ERROR
    np.add.at(diagonal, corners.of, weight * (along**2).sum(axis=1))
    np.add.at(along_slope, corners.of, weight * (along * looked.errors).sum(axis=1))
    size = CHANGES * count
    hessian = blocks.transpose(0, 2, 1, 3).reshape(size, size)
    return _Normal(cost, hessian, slope.ravel(), mixed.reshape(-1, size), diagonal, along_slope)


def _motion(points: F64, centres: F64, units: F64) -> F64:
    """Return the derivatives of points by changes of the similarity that brings them there, [M, 3, 7]."""
    x, y, z = (points - centres).T
    found = np.zeros((len(points), 3, CHANGES))
    found[:, 0, 1], found[:, 0, 2] = z, -y
    found[:, 1, 0], found[:, 1, 2] = -z, x
    found[:, 2, 0], found[:, 2, 1] = y, -x
    found[:, [0, 1, 2], [3, 4, 5]] = units[:, None]
    found[:, :, 6] = points - centres
    return found
