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
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64
from gs2ci.core.cameras import in_camera, relative_to
from gs2ci.core.findings import Code, finding
from gs2ci.reconstruct.geometry.depth.sweep import inverse_depth_range, sweep
from gs2ci.reconstruct.geometry.depth.view_depths import depths_agree, turns_far, view_depths
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.kinds import PathSource, Verdict
from gs2ci.reconstruct.geometry.path.validity import doubts_about_path
from gs2ci.reconstruct.geometry.prior import Request
from gs2ci.reconstruct.geometry.sources.direct import at_rest
from gs2ci.reconstruct.geometry.sources.mapper import LEAST_MATCHES, MappedScene, grown_scene
from gs2ci.reconstruct.geometry.tracks.brightened import brightened
from gs2ci.reconstruct.geometry.tracks.features import find_features, match_features
from gs2ci.reconstruct.threads import in_threads, one_opencv_thread

# How many features of tilted pictures are kept in all views together, which bounds time and memory for matches.
_MOST_TILTED: Final = 64_000
# SIFT doubles the enlarged picture and keeps it at 11 levels of blur, in four bytes each and in all octaves. So much
# memory is taken for several views at once: half a gigabyte for one view of 720 x 960 px.
_BYTES_PER_PX: Final = 16 * 11 * 4 * 4 // 3
_FEATURES_BYTES: Final = 2**30


def wide_motion(request: Request, found: Geometry, *, tilted: bool = False) -> Geometry:
    """Estimate poses and depth from features matched between all pairs of views.

    Args:
        request: Its views are used.
        found: The tracks' geometry, of which the camera matrix and the middle view are used.
        tilted: Whether features are found in tilted pictures, too.

    Returns:
        A geometry with the verdict "full"; one at rest, "unsupported", if not every view joins one scene, if too few
        points confirm it, or if it turns far and the depths of the views along it do not agree.

    Raises:
        GeometryError: pycolmap, which grows the scene, cannot be had on this machine.
    """
    scene = _grown(request.views, found.intrinsics, tilted=tilted)
    still = replace(at_rest(found), source=PathSource.MATCHES)
    if scene is None:
        return still
    relative, ahead, unit = ahead_of(scene.world_to_camera, scene.points, found.reference)
    if len(ahead) < request.settings.criteria.tracks or 2 * len(ahead) < len(scene.points):
        return still
    settings, far = request.settings, turns_far(relative)
    if far:
        to_reference = scene.world_to_camera[found.reference]
        points = in_camera(scene.points, to_reference) * unit
        depths = view_depths(request.views, relative, still.intrinsics, still.reference, points, settings.sweep)
        if not depths_agree(depths, relative, still.intrinsics):
            return still
        depth = depths[0].inverse_depth
    else:
        span, depths = inverse_depth_range(ahead, settings.sweep), ()
        depth = sweep(request.views, relative, still.intrinsics, still.reference, span, settings.sweep)
    doubts = doubts_about_path(scene.path_error_expected, settings.criteria)
    # Those on missing tracks no longer matter.
    of_camera = (note for note in found.notes if note.code.name.startswith("FOCAL"))
    return replace(
        still,
        world_to_camera=relative,
        inverse_depth=depth,
        tracks=len(scene.points),
        reprojection_rms_px=scene.rms_px,
        verdict=Verdict.FULL,
        path_error_expected=scene.path_error_expected,
        # A path that turns far has no exact reversal, and the scene with the reverse order explains fewer matches.
        order_errors=settings.criteria.order_errors if far else None,
        view_depths=depths,
        notes=(*of_camera, finding(Code.WIDE_MOTION, points=len(scene.points)), *doubts),
    )


def ahead_of(world_to_camera: F64, points: F64, reference: int) -> tuple[F64, F64, float]:
    """Express poses relative to a view, in the unit in which the points ahead of it have a median inverse depth of 1.

    Args:
        world_to_camera: Poses, [N, 4, 4].
        points: In the world, [P, 3].
        reference: The view.

    Returns:
        The poses, [N, 4, 4]; the inverse depths of the points that lie ahead; and 1 of the world in the new unit.
    """
    poses, to_reference = relative_to(world_to_camera, reference), world_to_camera[reference]
    depths = points @ to_reference[2, :3] + to_reference[2, 3]
    ahead = 1 / depths[depths > 0]
    unit = float(np.median(ahead)) if len(ahead) else 1.0
    poses[:, :3, 3] *= unit
    return poses, ahead / unit, unit


def _grown(views: F32, intrinsics: F64, *, tilted: bool) -> MappedScene | None:
    """Build one scene from all pairs; None unless every view joins it."""
    at_once = max(1, _FEATURES_BYTES // (_BYTES_PER_PX * views.shape[1] * views.shape[2]))
    with one_opencv_thread() if at_once > 1 else nullcontext():
        features = in_threads(
            lambda view: find_features(view, _MOST_TILTED // len(views) if tilted else None),
            brightened(views),
            at_most=at_once,
        )
    pairs = {
        (i, j): matches
        for i, j in itertools.combinations(range(len(views)), 2)
        if len(matches := match_features(features[i][1], features[j][1])) >= LEAST_MATCHES
    }
    return grown_scene([places for places, _ in features], pairs, intrinsics, (views.shape[1], views.shape[2]))
