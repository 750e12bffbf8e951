"""Geometry from points matched between all pairs of views: wide baselines, in any order.

Corners can be tracked from view to view as long as patches look alike, over a few degrees. If a camera was put at
separate positions in no order, scale-invariant features (SIFT, Lowe 2004) still match between views that see the same
things, and are joined to one scene (`mapper`). From about 15° on, surfaces look foreshortened: features are then also
found in tilted pictures (ASIFT, Morel and Yu 2009), at ten times the time. Here: the features, the pairs, and the
geometry of their scene. Not here: the scene itself (`mapper`), when it is used (`choose`,
`hypotheses.matches`), the sweep
(`sweep`).
"""

import itertools
from contextlib import nullcontext
from dataclasses import replace
from typing import Any, Final

import cv2
import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.findings import Code, finding
from gs2ci.reconstruct.geometry.depth.surface_map import surface_map
from gs2ci.reconstruct.geometry.depth.sweep import inverse_depth_range
from gs2ci.reconstruct.geometry.depth.view_depths import depths_agree, turns_far, view_depths
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.kinds import Verdict
from gs2ci.reconstruct.geometry.path.validity import doubts_about_path
from gs2ci.reconstruct.geometry.prior import Request
from gs2ci.reconstruct.geometry.sources.direct import at_rest
from gs2ci.reconstruct.geometry.sources.mapper import LEAST_MATCHES, MappedScene, grown_scene
from gs2ci.reconstruct.geometry.tracks.brightened import brightened
from gs2ci.reconstruct.threads import in_threads, one_opencv_thread

# Decoded views are blurred: features are detected at twice their size, with equalised local contrast.
_ENLARGED: Final = 2
_MOST_FEATURES: Final = 2000
_LEAST_CONTRAST: Final = 0.01
# Pictures are tilted so many times, each by √2 more (OpenCV's `maxTilt`); and how many of their features are kept in
# all views together, which bounds time and memory for matches.
_STEEPEST: Final = 2
_MOST_TILTED: Final = 64_000
# SIFT doubles the enlarged picture and keeps it at 11 levels of blur, in four bytes each and in all octaves. So much
# memory is taken for several views at once: half a gigabyte for one view of 720 x 960 px.
_BYTES_PER_PX: Final = 16 * 11 * 4 * 4 // 3
_FEATURES_BYTES: Final = 2**30
# A match must be mutual, and nearer than this share of the distance to the second nearest feature (Lowe's test).
_RATIO: Final = 0.8
# Features are compared with those of another view so many at a time: of two views in tilted pictures, all at once would
# take 4 GB.
_ROWS: Final = 2048
_EPSILON: Final = 1e-6


def wide_motion(request: Request, found: Geometry, *, tilted: bool = False) -> Geometry:
    """Estimate poses and depth from features matched between all pairs of views.

    Args:
        request: Its views are used.
        found: The tracks' geometry, of which the camera matrix and the middle view are used.
        tilted: Whether features are found in tilted pictures, too.

    Returns:
        A geometry with the verdict "full"; one at rest, "unsupported", if not every view joins one scene, if too few
        points confirm it, or if it turns far and the depths of the views along it do not agree. It says how many
        views joined, if any did.
    """
    scene, joined = _grown(request.views, found.intrinsics, tilted=tilted)
    still = at_rest(found)
    if scene is None:
        return replace(still, joined=joined)
    relative = scene.world_to_camera @ np.linalg.inv(scene.world_to_camera[found.reference])
    to_reference = scene.world_to_camera[found.reference]
    depths = scene.points @ to_reference[2, :3] + to_reference[2, 3]
    ahead = 1 / depths[depths > 0]
    if len(ahead) < request.settings.criteria.tracks or 2 * len(ahead) < len(depths):
        return still
    unit = float(np.median(ahead))
    relative[:, :3, 3] *= unit
    settings, far = request.settings, turns_far(relative)
    if far:
        points = (scene.points @ to_reference[:3, :3].T + to_reference[:3, 3]) * unit
        depths = view_depths(request.views, relative, still.intrinsics, still.reference, points, settings.sweep)
        if not depths_agree(depths, relative, still.intrinsics):
            return still
        depth = depths[0].inverse_depth
    else:
        span, depths = inverse_depth_range(ahead / unit, settings.sweep), ()
        depth = surface_map(request.views, relative, still.intrinsics, still.reference, span, settings.sweep)
    doubts = doubts_about_path(scene.error_expected, settings.criteria)
    return replace(
        still,
        world_to_camera=relative,
        inverse_depth=depth,
        tracks=len(scene.points),
        reprojection_rms_px=scene.rms_px,
        verdict=Verdict.FULL,
        path_error_expected=scene.error_expected,
        # A path that turns far has no exact reversal, and the scene with the reverse order explains fewer matches.
        order_errors=settings.criteria.order_errors if far else None,
        view_depths=depths,
        notes=(*_of_camera(found), finding(Code.WIDE_MOTION, points=len(scene.points)), *doubts),
    )


def _of_camera(found: Geometry) -> tuple[Any, ...]:
    """Keep the notes on the camera matrix; those on missing tracks no longer matter."""
    return tuple(note for note in found.notes if note.code.name.startswith("FOCAL"))


def _grown(views: F32, intrinsics: F64, *, tilted: bool) -> tuple[MappedScene | None, int]:
    """Build one scene from all pairs, None unless every view joins it; and return how many views joined."""
    at_once = max(1, _FEATURES_BYTES // (_BYTES_PER_PX * views.shape[1] * views.shape[2]))
    with one_opencv_thread() if at_once > 1 else nullcontext():
        features = in_threads(
            lambda view: _features(view, _MOST_TILTED // len(views) if tilted else None),
            brightened(views),
            at_most=at_once,
        )
    pairs = {
        (i, j): matches
        for i, j in itertools.combinations(range(len(views)), 2)
        if len(matches := _matches(features[i][1], features[j][1])) >= LEAST_MATCHES
    }
    return grown_scene([places for places, _ in features], pairs, intrinsics, (views.shape[1], views.shape[2]))


def _features(view: F32, tilted: int | None = None) -> tuple[F32, F32]:
    """Find features of a view: positions, [F, 2] px, and RootSIFT descriptors, [F, 128].

    Args:
        view: [H, W, C].
        tilted: At most so many, the strongest, of tilted pictures, too; None: of the view as it is.
    """
    grey = (view.mean(axis=2).clip(0, 1) * 255).astype(np.uint8)
    large = cv2.resize(grey, None, fx=_ENLARGED, fy=_ENLARGED, interpolation=cv2.INTER_CUBIC)
    even = cv2.createCLAHE(2.0, (8, 8)).apply(large)
    sift = cv2.SIFT_create(nfeatures=_MOST_FEATURES, contrastThreshold=_LEAST_CONTRAST)  # type: ignore[attr-defined]
    finder = sift if tilted is None else cv2.AffineFeature_create(sift, _STEEPEST)  # type: ignore[attr-defined]
    points, found = finder.detectAndCompute(even, None)
    if found is None:
        return np.zeros((0, 2), np.float32), np.zeros((0, 128), np.float32)
    if tilted is not None and len(points) > tilted:
        strongest = np.argsort([-point.response for point in points], kind="stable")[:tilted]
        points, found = [points[k] for k in strongest], found[strongest]
    places = np.array([point.pt for point in points], np.float32)
    # OpenCV has the first pixel's centre at 0, this project at 0.5.
    places = ((places + 0.5) / _ENLARGED).astype(np.float32)
    shares = found / np.maximum(found.sum(axis=1, keepdims=True), _EPSILON)
    return places, np.sqrt(shares).astype(np.float32)


def _matches(one: F32, other: F32) -> np.ndarray[Any, np.dtype[np.uint32]]:
    """Match descriptors, [F, 128] and [G, 128]: indices, [M, 2]."""
    if len(one) < 2 or len(other) < 2:
        return np.zeros((0, 2), np.uint32)
    # Descriptors have length 1: the nearest has the largest product.
    nearest = np.empty(len(one), np.int64)
    best, second = np.empty((2, len(one)), np.float32)
    of_other = np.full(len(other), -np.inf, np.float32)
    for first in range(0, len(one), _ROWS):
        rows = slice(first, first + _ROWS)
        likeness = one[rows] @ other.T
        here = np.arange(len(likeness))
        nearest[rows] = at = likeness.argmax(axis=1)
        best[rows] = likeness[here, at]
        # The largest of a column, not where it is: that takes NumPy 20 times as long.
        np.maximum(of_other, likeness.max(axis=0), out=of_other)
        likeness[here, at] = -1
        second[rows] = likeness.max(axis=1)
    distance, to_second = (np.sqrt(np.maximum(2 - 2 * value, 0)) for value in (best, second))
    kept = np.flatnonzero((best == of_other[nearest]) & (distance < _RATIO * to_second))
    # Of features that are exactly alike, the first.
    _, firsts = np.unique(nearest[kept], return_index=True)
    kept = kept[np.sort(firsts)]
    return np.stack([kept, nearest[kept]], axis=1).astype(np.uint32)
