"""Paths and depths of exposures after they were tied: from corners that several of them see.

    corners of every pair ─► similarities and depths of corners (`together`) ─► each depth map brought to its corners ─►
    each view placed among them ─► and again, with the better pictures

A small motion leaves a depth map stretched and offset in inverse depth, or with near and far exchanged. Other exposures
see the same corners from farther away, so that the map's two numbers can be fitted, and every view's camera be placed
among them.

Here: these rounds. Not here: where the ties come from (`pairs`, `loops`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.colmap import colmap_camera, pycolmap
from gs2ci.reconstruct.exposures.corners import followed
from gs2ci.reconstruct.exposures.pictures import MeanPicture, pictures_of
from gs2ci.reconstruct.exposures.similarity import CHANGES, Similarity
from gs2ci.reconstruct.exposures.together import Adjusted, Corners, adjusted_together
from gs2ci.reconstruct.geometry.depth.view_depths import project
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.kinds import Verdict
from gs2ci.reconstruct.geometry.tracks.tracks import find_tracks
from gs2ci.reconstruct.measurement.noise import MEDIAN_DEVIATE

# Rounds of corners, maps and paths: each halves what the depth maps were off by.
ROUNDS: Final = 3
# A map and a path need so many corners, and a view of it so many that it sees.
_LEAST_CORNERS: Final = 30
_LEAST_SEEN: Final = 12
# Corners count less if their inverse depth is off the map by so many standard deviations.
_ROBUST: Final = 2.0
_FITS: Final = 10
_POSE_LOSS_PX: Final = 0.5
# Inverse depths of a map stay within these multiples of those of its corners.
_RANGE: Final = (0.5, 1.5)
_ENDS: Final = (1.0, 99.0)


@dataclass(frozen=True, eq=False)
class Refined:
    """Exposures with the paths and depths that they give each other.

    Args:
        geometries: By index of the exposure, each in its own coordinates.
        similarities: common_from_own, by index.
        errors: Standard errors of each: turn, rad; movement of what it sees, as a share of its distance; [2]; zeros for
            the first.
        corners: How many corners each shares with others.
        distance_px: Median distance of what is seen from where it should be; None if no corner was found.
    """

    geometries: dict[int, Geometry]
    similarities: dict[int, Similarity]
    errors: dict[int, F64]
    corners: dict[int, int]
    distance_px: float | None


def refined(
    views: Mapping[int, F32],
    geometries: Mapping[int, Geometry],
    similarities: Mapping[int, Similarity],
    pairs: Sequence[tuple[int, int]],
) -> Refined:
    """Refine the similarities, paths and depths of exposures that pairs tie.

    Args:
        views: Of each exposure, by index, [N, H, W, C].
        geometries: In its own coordinates.
        similarities: common_from_own; the first one is held.
        pairs: Indices of exposures that see the same things.
    """
    now, placed, order = dict(geometries), dict(similarities), list(similarities)
    for _ in range(ROUNDS):
        pictures = {k: pictures_of(views[k], now[k]) for k in order}
        corners = _gathered(pictures, placed, pairs, order)
        centres, units = _seen(pictures, placed, corners, order)
        found = adjusted_together([placed[k] for k in order], corners, centres, units)
        placed = dict(zip(order, found.similarities, strict=True))
        for index, k in enumerate(order):
            own = corners.hosts == index
            if own.sum() >= _LEAST_CORNERS and len(pictures[k]) == 1:
                points = corners.cameras[own] + (corners.points - corners.cameras)[own] * found.stretches[own, None]
                now[k] = _given_corners(now[k], views[k], points)
    counts = {k: int((corners.hosts == index).sum()) for index, k in enumerate(order)}
    distance_px = float(np.median(found.distances_px)) if len(found.distances_px) else None
    return Refined(now, placed, _errors(found, order), counts, distance_px)


def _gathered(
    pictures: Mapping[int, Sequence[MeanPicture]],
    similarities: Mapping[int, Similarity],
    pairs: Sequence[tuple[int, int]],
    order: Sequence[int],
) -> Corners:
    """Follow the corners of each exposure of each pair into the other."""
    numbers: dict[tuple[int, int, int], int] = {}
    points: list[F64] = []
    cameras: list[F64] = []
    seen: list[tuple[int, int, MeanPicture, F64]] = []
    for one, other in [*pairs, *((b, a) for a, b in pairs)]:
        matches, _ = followed(pictures[one], pictures[other], similarities[other].inverse.after(similarities[one]))
        for point, place, (i, j), corner in zip(
            matches.other, matches.at_one, matches.pictures, matches.corners, strict=True
        ):
            key = (order.index(other), int(j), int(corner))
            if key not in numbers:
                numbers[key] = len(points)
                points.append(point)
                cameras.append(pictures[other][j].centre)
            seen.append((numbers[key], order.index(one), pictures[one][i], place))
    return Corners(
        points=np.array(points).reshape(-1, 3),
        hosts=np.array([host for host, _, _ in numbers], np.int64),
        cameras=np.array(cameras).reshape(-1, 3),
        of=np.array([of for of, _, _, _ in seen], np.int64),
        by=np.array([by for _, by, _, _ in seen], np.int64),
        poses=np.array([picture.world_to_camera for _, _, picture, _ in seen]).reshape(-1, 4, 4),
        intrinsics=np.array([picture.intrinsics for _, _, picture, _ in seen]).reshape(-1, 3, 3),
        places=np.array([place for _, _, _, place in seen]).reshape(-1, 2),
    )


def _seen(
    pictures: Mapping[int, Sequence[MeanPicture]],
    similarities: Mapping[int, Similarity],
    corners: Corners,
    order: Sequence[int],
) -> tuple[F64, F64]:
    """Return the middle of each exposure's corners in common coordinates, [E, 3], and its distance, [E]."""
    centres, units = np.zeros((len(order), 3)), np.ones(len(order))
    for index, k in enumerate(order):
        camera = pictures[k][0]
        own = corners.points[corners.hosts == index]
        middle = np.median(own, axis=0) if len(own) else camera.lifted(camera.intrinsics[:2, 2][None])[0]
        centres[index] = similarities[k].points(middle)
        units[index] = similarities[k].scale * float(np.linalg.norm(middle - camera.centre))
    return centres, units


def _given_corners(geometry: Geometry, views: F32, points: F64) -> Geometry:
    """Return a geometry whose depth map and path agree with corners, [P, 3], of its reference view."""
    reference = geometry.world_to_camera[geometry.reference]
    pixels, depth = project(points, reference, geometry.intrinsics)
    poses = _path(geometry, views, pixels, points)
    return replace(
        geometry, world_to_camera=poses, inverse_depth=_map(geometry.inverse_depth, pixels, depth), verdict=Verdict.FULL
    )


def _map(inverse_depth: F32, pixels: F64, depth: F64) -> F32:
    """Stretch and offset a map of inverse depths, [H, W], so that it fits corners, at [P, 2] px."""
    height, width = inverse_depth.shape
    columns, rows = pixels.astype(int).clip(0, (width - 1, height - 1)).T
    model = np.stack([inverse_depth[rows, columns].astype(np.float64), np.ones(len(depth))], axis=1)
    known = 1 / depth
    weight: F64 = np.ones(len(depth))
    numbers: F64 = np.zeros(2)
    for _ in range(_FITS):
        numbers = np.asarray(np.linalg.lstsq(model * weight[:, None], known * weight, rcond=None)[0], np.float64)
        off = np.abs(known - model @ numbers)
        spread = max(float(np.median(off)) / MEDIAN_DEVIATE, float(np.finfo(np.float64).tiny))
        weight = 1 / np.sqrt(1 + (off / (_ROBUST * spread)) ** 2)
    far, near = np.percentile(known, _ENDS) * _RANGE
    return (numbers[0] * inverse_depth + numbers[1]).clip(far, near).astype(np.float32)


def _path(geometry: Geometry, views: F32, pixels: F64, points: F64) -> F64:
    """Place the camera of each view among points, [P, 3], that the reference view sees at [P, 2] px."""
    poses = geometry.world_to_camera.copy()
    tracks = find_tracks(views, geometry.reference, pixels).positions
    camera = colmap_camera(geometry.intrinsics, (views.shape[1], views.shape[2]))
    options = pycolmap.AbsolutePoseRefinementOptions()
    options.loss_function_scale = _POSE_LOSS_PX
    start = pycolmap.Rigid3d(poses[geometry.reference, :3])
    for view in range(len(views)):
        seen = np.isfinite(tracks[:, view, 0])
        if view == geometry.reference or seen.sum() < _LEAST_SEEN:
            continue
        all_right = np.ones(int(seen.sum()), bool)
        found: Any = pycolmap.refine_absolute_pose(start, tracks[seen, view], points[seen], all_right, camera, options)
        if found is not None and np.isfinite(placed := found["cam_from_world"].matrix()).all():
            poses[view, :3] = placed
    return poses


def _errors(found: Adjusted, order: Sequence[int]) -> dict[int, F64]:
    """Return the standard errors of each similarity, [2]; larger than foretold where distances are."""
    deviations = np.sqrt(np.diag(found.covariance).clip(0)).reshape(-1, CHANGES)
    errors = {order[0]: np.zeros(2)}
    for k, own in zip(order[1:], deviations, strict=True):
        errors[k] = np.linalg.norm(own[:6].reshape(2, 3), axis=1)
    return errors
