"""From decoded views to camera path and depth: tracks, motion, plane sweep, and the fallbacks, on one page.

Here: the order of the steps and the fallbacks. Not here: any step itself. `gs2ci.reconstruct.pipeline` and the fit
import `Geometry` and `initialise` from this file.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from gs2ci.core.bounds import Bounded
from gs2ci.core.errors import GeometryError, InputError
from gs2ci.core.findings import Code, Finding, finding
from gs2ci.core.progress import Progress, Silent, said
from gs2ci.core.records import check_intrinsics
from gs2ci.reconstruct.choices import LeftOut
from gs2ci.reconstruct.geometry.depth.surface_map import surface_map
from gs2ci.reconstruct.geometry.depth.sweep import LEAST_PLANES, SweepSettings, inverse_depth_range, sweep
from gs2ci.reconstruct.geometry.depth.view_depths import ViewDepth
from gs2ci.reconstruct.geometry.kinds import ESTIMATED, GIVEN, PathSource, Verdict
from gs2ci.reconstruct.geometry.path.bundle import adjust_bundle
from gs2ci.reconstruct.geometry.path.focal import FocalSettings, default_focal, estimate_focal
from gs2ci.reconstruct.geometry.path.halves import expected_path_error, times_better_foretold
from gs2ci.reconstruct.geometry.path.motion import (
    CameraMotion,
    MotionSettings,
    adjust,
    estimate_motion,
    predict_positions,
    preference,
    reversed_depth,
)
from gs2ci.reconstruct.geometry.path.rotations import fit_rotations
from gs2ci.reconstruct.geometry.path.telemetry import PoseErrors, errors_of_given, place_points
from gs2ci.reconstruct.geometry.path.validity import (
    Criteria,
    classify_motion,
    contradictions,
    doubts_about_path,
    doubts_about_tracks,
    halves_agree,
    parallax_px,
    supported_views,
)
from gs2ci.reconstruct.geometry.tracks.tracks import (
    Tracks,
    TrackSettings,
    find_corners,
    find_tracks,
    refine_tracks,
    within,
)

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

# A point counts if at least this share of the views see it.
_LEAST_SHARE_OF_VIEWS = 0.6
# Given poses are contradicted if those of one half of the tracks explain the other half so many times better. Of 24
# draws of 72 x 96 px exact poses had 0.88 to 1.06, and 1.18 to 1.24 in three whose cameras shake by a pixel from view
# to view, which a decode blurs. Positions off by 5 % of the path had more than 1.05 in 21.
_CONTRADICTED = 1.05
PLANE_NOTE = finding(Code.DEPTH_STARTS_AS_PLANE)


@dataclass(frozen=True)
class GeometrySettings(Bounded):
    """Settings of every step.

    Args:
        tracks: Of the tracks.
        motion: Of the motion.
        focal: Of the focal length.
        criteria: Which motions and tracks are trusted.
        sweep: How finely to sweep.
        left_out: Parts that `auto` leaves out, by the names of `gs2ci.reconstruct.mechanisms`.
    """

    tracks: TrackSettings = field(default_factory=TrackSettings)
    motion: MotionSettings = field(default_factory=MotionSettings)
    focal: FocalSettings = field(default_factory=FocalSettings)
    criteria: Criteria = field(default_factory=Criteria)
    sweep: SweepSettings = field(default_factory=SweepSettings)
    left_out: tuple[LeftOut, ...] = ()


@dataclass(frozen=True)
class Geometry:
    """Camera path and depth, and how reliable they are.

    Args:
        world_to_camera: Poses, [N, 4, 4]; the identity for the reference view.
        intrinsics: Camera matrix in px, [3, 3]; pixel centres at +0.5.
        focal_source: "file", "estimated" or "default".
        inverse_depth: Of the reference view, [H, W] float32, > 0, of arbitrary scale; about 1 in the median.
        reference: Index of the reference view.
        tracks: Number of tracks that the motion explains.
        reprojection_rms_px: Their reprojection error.
        parallax_px: Part of the tracks that translation explains beyond the best rotations, root mean square.
        verdict: "full"; or why depth is only a plane: "rotation_only", "static", "unsupported".
        notes: Findings for the user.
        source: The geometry prior that it comes from.
        path_error_expected: Expected error of the path, from halves of the tracks (`halves`), as a share of its extent;
            None if the path was given, or there is none.
        unit: A length of 1 in the unit of the given poses; None if none were given, or they were not used.
        order_errors: By how many standard errors the tracks prefer this order of depth to the reverse
            (`motion.preference`); None without tracks, or if they have no second solution.
        other_order: The tracks' solution in the reverse order of depth; None if there is none, or poses were given.
        pose_errors: Standard errors of the poses, for a prior on them; None if they were not given, or the tracks
            contradict them.
        order_given: Whether a stage settles the order of depth: tracked points lie in front of its cameras, not behind.
        view_depths: Depths of the reference view and of others, if the path turns far; otherwise none.
        joined: How many views matched features joined to one scene, if not all of them.
        path_notes: Findings about the path, which do not hold for a camera at rest.
    """

    world_to_camera: F64
    intrinsics: F64
    focal_source: str
    inverse_depth: F32
    reference: int
    tracks: int
    reprojection_rms_px: float
    parallax_px: float
    verdict: Verdict
    notes: tuple[Finding, ...]
    source: str = PathSource.TRACKS
    path_error_expected: float | None = None
    unit: float | None = None
    order_errors: float | None = None
    other_order: "OtherOrder | None" = None
    pose_errors: PoseErrors | None = None
    order_given: bool = False
    view_depths: tuple[ViewDepth, ...] = ()
    joined: int = 0
    path_notes: tuple[Finding, ...] = ()

    @property
    def known_at_rest(self) -> bool:
        """Get whether the camera is known to be at rest: its poses are held, and a still scene is one picture."""
        return self.source == PathSource.REST

    @property
    def has_path(self) -> bool:
        """Get whether there is a path, and depths along it."""
        return self.verdict == Verdict.FULL

    @property
    def is_given(self) -> bool:
        """Get whether a stage or a file gave the poses."""
        return self.source in GIVEN

    @property
    def is_estimated(self) -> bool:
        """Get whether the path is estimated from this measurement alone."""
        return self.source in ESTIMATED

    @property
    def is_uniform(self) -> bool:
        """Get whether it is a uniform motion, which no tracks confirm."""
        return self.source == PathSource.UNIFORM

    @property
    def is_matched(self) -> bool:
        """Get whether it comes from features matched between all pairs of views."""
        return self.source == PathSource.MATCHES

    @property
    def lacks_path(self) -> bool:
        """Get whether no path was found, so that a scene is a plane before a camera that at most turned."""
        return self.is_estimated and not self.has_path


@dataclass(frozen=True)
class OtherOrder:
    """A solution in which near and far are exchanged.

    Args:
        world_to_camera: Its poses, [N, 4, 4].
        inverse_depth: Of the reference view, [H, W] float32.
        reprojection_rms_px: Of the tracks that it explains.
    """

    world_to_camera: F64
    inverse_depth: F32
    reprojection_rms_px: float

    @classmethod
    def of(cls, geometry: Geometry) -> "OtherOrder":
        """Return the path and the depths of a geometry."""
        return cls(geometry.world_to_camera, geometry.inverse_depth, geometry.reprojection_rms_px)


def initialise(
    views: F32,
    intrinsics: F64 | None,
    settings: GeometrySettings | None = None,
    progress: Progress | None = None,
    known_poses: F64 | None = None,
    seen: Bool | None = None,
) -> Geometry:
    """Estimate camera poses and the depth of the middle view from decoded views.

    Args:
        views: [N, H, W, C] float32 in [0, 1], in the order of exposure; C is 1 or 3.
        intrinsics: Camera matrix in px, [3, 3], or None to have the focal length estimated.
        settings: Settings of every step.
        progress: Receives each step, and a sentence on every fallback.
        known_poses: World-to-camera poses, [N, 4, 4], to use instead of estimated ones, in any frame and unit.
        seen: Which pixels the sensor sees, [H, W]; None: all.

    Returns:
        A geometry, always finite: if depth cannot be found, a plane at inverse depth 1, and `notes` say why.

    Raises:
        InputError: The views are not a stack of finite images, or the settings make no sense.
        GeometryError: The known poses contradict the tracks.
    """
    _check(views, intrinsics)
    settings, progress = (settings or GeometrySettings()).check(), progress or Silent()
    progress.stage("geometry", 3)
    size, reference = (views.shape[1], views.shape[2]), len(views) // 2
    corners = find_corners(views, reference, settings.tracks)
    tracks = _followed(views, corners, settings, seen)
    progress.step(1, tracks=len(tracks))
    doubts = doubts_about_tracks(tracks, size, settings.criteria)
    flat = geometry = _flat(len(views), size, _focal(intrinsics, tracks, size, bool(doubts), settings), doubts)
    if not doubts:
        again = partial(_second_look, views=views, corners=corners, settings=settings, seen=seen)
        found = _found_twice(flat, tracks, known_poses, settings, again, moved=known_poses is not None)
        if found.geometry.verdict in (Verdict.ROTATION_ONLY, Verdict.STATIC):
            moved = _found_twice(flat, tracks, None, settings, again, moved=True)
            found = moved if _halves_agree(moved, settings) else found
        geometry = found.geometry
        progress.step(2, tracks=geometry.tracks, rms_px=geometry.reprojection_rms_px)
        if geometry.has_path:
            geometry = _doubted(found, settings) if known_poses is None else measured(geometry, known_poses)
            geometry = replace(geometry, inverse_depth=_depth(geometry, found.motion, views, settings.sweep))
            geometry = _with_reverse(replace(found, geometry=geometry), views, settings, posed=known_poses is not None)
    progress.step(3)
    said(geometry.notes, progress)
    return geometry


def before_camera_at_rest(
    views: int, size: tuple[int, int], intrinsics: F64 | None, settings: FocalSettings, note: Finding
) -> Geometry:
    """Return the geometry of a camera that is known to be at rest: a plane at inverse depth 1.

    Args:
        views: How many.
        size: Height and width, px.
        intrinsics: Camera matrix in px, [3, 3], or None to assume the default field of view, on which nothing depends.
        settings: With the latter.
        note: Why the camera is taken to be at rest.
    """
    if intrinsics is None:
        assumed = default_focal(size, "a camera at rest does not show it", settings)
        flat = _flat(views, size, (assumed.intrinsics, assumed.source, (note,)), ())
    else:
        flat = _flat(views, size, (intrinsics.astype(np.float64), "file", (note,)), ())
    return replace(flat, verdict=Verdict.STATIC, source=PathSource.REST)


def usable_tracks(views: F32, settings: GeometrySettings, seen: Bool | None = None) -> Tracks:
    """Find the tracks that a geometry may be based on, from the corners of the middle view; there may be none."""
    return _followed(views, find_corners(views, len(views) // 2, settings.tracks), settings, seen)


def _followed(views: F32, corners: F64, settings: GeometrySettings, seen: Bool | None) -> Tracks:
    return _usable(find_tracks(views, len(views) // 2, corners, settings.tracks), settings.criteria, seen)


@dataclass(frozen=True)
class _Found:
    """A geometry, and the motion and the explained tracks that it is based on."""

    geometry: Geometry
    motion: CameraMotion
    tracks: Tracks


def _found_twice(
    flat: Geometry,
    tracks: Tracks,
    known_poses: F64 | None,
    settings: GeometrySettings,
    again: Callable[[_Found, Tracks], Tracks],
    *,
    moved: bool,
) -> _Found:
    """Estimate the camera's motion, and again from new tracks that start where the first estimate predicts them.

    Args:
        flat: The assumption without an estimate.
        tracks: All usable ones.
        known_poses: Poses to use, or None.
        settings: Of every step.
        again: Finds the new tracks.
        moved: Whether the camera is known to have moved; otherwise the tracks must show it.
    """
    first = _found(flat, tracks, known_poses, settings, moved=moved)
    if not first.geometry.has_path or LeftOut.TRACKS_SOUGHT_TWICE in settings.left_out:
        return first
    second = _found(flat, again(first, tracks), known_poses, settings, moved=moved)
    return second if second.geometry.has_path else first


def _halves_agree(found: _Found, settings: GeometrySettings) -> bool:
    """Tell whether halves of the tracks give the same path, as they do if the camera moved.

    If a path comes from the tracks' errors, each half gives a different one.
    """
    geometry, criteria = found.geometry, settings.criteria
    if not geometry.has_path or geometry.parallax_px < criteria.parallax_px:
        return False
    error = _expected_error(found, settings)
    return halves_agree(error, criteria)


def _found(
    flat: Geometry, tracks: Tracks, known_poses: F64 | None, settings: GeometrySettings, *, moved: bool
) -> _Found:
    """Estimate the camera's motion from all tracks, or place the points of those that agree with known poses."""
    how, candidates = settings.motion, len(tracks)
    if known_poses is not None:
        motion, kept = place_points(tracks, known_poses, flat.intrinsics, how.huber_px, how.outlier_px)
        return _Found(_moved(flat, candidates, kept, motion, settings, moved=True, posed=True), motion, kept)
    motion, kept = estimate_motion(tracks, flat.intrinsics, how)
    first = _Found(_moved(flat, candidates, kept, motion, settings, moved=moved), motion, kept)
    if not first.geometry.has_path or LeftOut.ADJUSTMENT_OF_POINTS in settings.left_out:
        return first
    return _freed(first, flat, candidates, settings, moved=moved)


def _freed(found: _Found, flat: Geometry, candidates: int, settings: GeometrySettings, *, moved: bool) -> _Found:
    """Adjust again with points that may leave the rays of their corners; return `found` if that fails.

    The positions in the middle view have errors like all others, most of all from the residue of its mask. Over 38
    first geometries this adjustment lowered the error of the path by 15 % and that of rotations by 11 % in the
    geometric mean, and by half in the scene whose cameras go forward (`python -m tests.benchmarks path_error`). It
    needs a start near its minimum.
    """
    how = settings.motion
    try:
        poses = adjust_bundle(
            found.tracks, found.motion.world_to_camera, flat.intrinsics, how.huber_px, refine_focal=False
        ).world_to_camera
        motion, kept = place_points(found.tracks, poses, flat.intrinsics, how.huber_px, how.outlier_px)
    except GeometryError:
        return found
    freed = _Found(_moved(flat, candidates, kept, motion, settings, moved=moved), motion, kept)
    return freed if freed.geometry.has_path else found


def _second_look(
    found: _Found, tracks: Tracks, *, views: F32, corners: F64, settings: GeometrySettings, seen: Bool | None
) -> Tracks:
    """Track all corners again, starting where a rough depth map predicts them; return the first tracks if that fails.

    On fourteen decoded scenes this lowered the error of the path by 5 % and that of rotations by 9 %; where only few
    tracks had been found, it doubled their number.
    """
    rough = replace(
        settings.sweep,
        planes=max(settings.sweep.planes // 2, LEAST_PLANES),
        most_pixels=min(settings.sweep.most_pixels, views[0, ..., 0].size) // 4,
    )
    geometry = found.geometry
    span = inverse_depth_range(found.motion.inverse_depth, rough)
    depth = sweep(views, geometry.world_to_camera, geometry.intrinsics, geometry.reference, span, rough)
    at = corners.astype(int)
    predicted = predict_positions(
        corners, depth[at[:, 1], at[:, 0]].astype(np.float64), geometry.world_to_camera, geometry.intrinsics
    )
    again = _usable(refine_tracks(views, geometry.reference, predicted, settings.tracks), settings.criteria, seen)
    loses_views = again.seen.any(axis=0).sum() < tracks.seen.any(axis=0).sum()
    return tracks if loses_views or doubts_about_tracks(again, depth.shape, settings.criteria) else again


def _depth(geometry: Geometry, motion: CameraMotion, views: F32, settings: SweepSettings) -> F32:
    span = inverse_depth_range(motion.inverse_depth, settings)
    return surface_map(views, geometry.world_to_camera, geometry.intrinsics, geometry.reference, span, settings)


def _check(views: F32, intrinsics: F64 | None) -> None:
    if views.ndim != 4 or views.shape[3] not in (1, 3) or 0 in views.shape:
        raise InputError(f"views have shape {list(views.shape)}", allowed="[N, H, W, 3] or [N, H, W, 1]")
    if not np.isfinite(views).all():
        raise InputError("the decoded views hold values that are NaN or infinite", allowed="finite numbers")
    if intrinsics is not None:
        check_intrinsics(intrinsics)


def _usable(tracks: Tracks, criteria: Criteria, seen: Bool | None) -> Tracks:
    """Keep tracks that most views see, and drop the views that too few tracks reach."""
    tracks = tracks if seen is None else within(tracks, seen)
    views = tracks.positions.shape[1]
    long = tracks.seen_by_at_least(max(2, int(np.ceil(_LEAST_SHARE_OF_VIEWS * views))))
    positions = long.positions.copy()
    positions[:, ~supported_views(long, criteria)] = np.nan
    return Tracks(positions, tracks.reference).seen_by_at_least(2)


def _focal(
    intrinsics: F64 | None, tracks: Tracks, size: tuple[int, int], doubtful: bool, settings: GeometrySettings
) -> tuple[F64, str, tuple[Finding, ...]]:
    """Get the camera matrix, its source and the findings about it."""
    if intrinsics is not None:
        return intrinsics.astype(np.float64), "file", ()
    if doubtful:
        focal = default_focal(size, "too few points could be tracked to estimate it", settings.focal)
    else:
        focal = estimate_focal(tracks, size, settings.focal, settings.motion)
    return focal.intrinsics, focal.source, (focal.note,)


def _flat(
    views: int, size: tuple[int, int], focal: tuple[F64, str, tuple[Finding, ...]], doubts: tuple[Finding, ...]
) -> Geometry:
    """Return the assumption without an estimate: a camera at rest in front of a plane at inverse depth 1."""
    intrinsics, source, notes = focal
    return Geometry(
        world_to_camera=np.tile(np.eye(4), (views, 1, 1)),
        intrinsics=intrinsics,
        focal_source=source,
        inverse_depth=np.ones(size, np.float32),
        reference=views // 2,
        tracks=0,
        reprojection_rms_px=0.0,
        parallax_px=0.0,
        verdict=Verdict.UNSUPPORTED,
        notes=(*notes, *doubts, *((PLANE_NOTE,) if doubts else ())),
    )


def _moved(
    geometry: Geometry,
    candidates: int,
    tracks: Tracks,
    motion: CameraMotion,
    settings: GeometrySettings,
    *,
    moved: bool,
    posed: bool = False,
) -> Geometry:
    """Return the geometry with the motion, with its rotations alone, or only with the reason why neither is used.

    If the camera is known to have moved, its whole motion is used unless the tracks contradict it, however small the
    parallax. Given poses are kept for views that see too few tracks as well.
    """
    rotations = fit_rotations(tracks, geometry.intrinsics, settings.motion)
    if moved:
        reasons = contradictions(candidates, tracks, motion, settings.criteria)
        verdict: Verdict = Verdict.UNSUPPORTED if reasons else Verdict.FULL
    else:
        verdict, reasons = classify_motion(candidates, tracks, motion, rotations, settings.criteria)
    notes = (*geometry.notes, *reasons, *(() if verdict == Verdict.FULL else (PLANE_NOTE,)))
    poses = geometry.world_to_camera.copy()
    if verdict == Verdict.FULL:
        poses = motion.world_to_camera
    elif verdict == Verdict.ROTATION_ONLY:
        poses[:, :3, :3] = rotations.rotations
    missing = np.flatnonzero(~tracks.seen.any(0))
    if len(missing) and (verdict == Verdict.ROTATION_ONLY or (verdict == Verdict.FULL and not posed)):
        poses = _with_missing_poses(poses, missing)
        notes = (*notes, finding(Code.POSES_INTERPOLATED, views=missing.tolist()))
    return replace(
        geometry,
        world_to_camera=poses,
        tracks=len(tracks),
        reprojection_rms_px=motion.rms_px,
        parallax_px=parallax_px(motion, rotations),
        verdict=verdict,
        notes=notes,
    )


def _doubted(found: _Found, settings: GeometrySettings) -> Geometry:
    """Return the geometry with the expected error of its path."""
    geometry, error = found.geometry, _expected_error(found, settings)
    notes = (*geometry.notes, *doubts_about_path(error, settings.criteria))
    return replace(geometry, path_error_expected=error, notes=notes)


def _expected_error(found: _Found, settings: GeometrySettings) -> float | None:
    geometry = found.geometry
    size = (geometry.inverse_depth.shape[0], geometry.inverse_depth.shape[1])
    return expected_path_error(found.motion, found.tracks, geometry.intrinsics, size, settings.motion)


def _with_reverse(found: _Found, views: F32, settings: GeometrySettings, *, posed: bool) -> Geometry:
    """Add how sure tracks are of the order of depth and, if they are not, their solution in the reverse order.

    Both motions are adjusted in the same way, each from a start near the other's reversal, so that the comparison is
    fair.
    """
    geometry, how = found.geometry, settings.motion
    here = adjust(found.tracks, geometry.intrinsics, how, start=found.motion)
    if posed and _borne_out(found, here, settings):
        geometry = replace(geometry, pose_errors=errors_of_given(geometry.world_to_camera, geometry.intrinsics))
    there = adjust(found.tracks, geometry.intrinsics, how, start=reversed_depth(here))
    if np.corrcoef(here.inverse_depth, there.inverse_depth)[0, 1] >= 0:
        return geometry  # the reversal is no minimum of its own
    errors = preference(here, there, how.huber_px)
    known = replace(geometry, order_errors=errors)
    scale = float(np.median(there.inverse_depth))
    if posed or errors >= settings.criteria.order_errors or scale <= 0:
        return known
    there = replace(there, translations=there.translations * scale, inverse_depth=there.inverse_depth / scale)
    missing = np.flatnonzero(~found.tracks.seen.any(0))
    poses = _with_missing_poses(there.world_to_camera, missing) if len(missing) else there.world_to_camera
    reverse = replace(geometry, world_to_camera=poses, reprojection_rms_px=there.rms_px)
    reverse = replace(reverse, inverse_depth=_depth(reverse, there, views, settings.sweep), order_errors=-errors)
    return replace(known, other_order=OtherOrder.of(reverse))


def _borne_out(found: _Found, adjusted: CameraMotion, settings: GeometrySettings) -> bool:
    """Tell whether tracks contradict given poses no more than their own noise explains.

    Positions off by 5 % of the path are contradicted in two scenes of four; if tracks are few or the camera moves
    forward, they are not (scenes of `python -m tests.benchmarks given_poses`).
    """
    height, width = found.geometry.inverse_depth.shape
    how, intrinsics = settings.motion, found.geometry.intrinsics
    times = times_better_foretold(found.motion, adjusted, found.tracks, intrinsics, (height, width), how)
    return times <= _CONTRADICTED


def measured(geometry: Geometry, known_poses: F64) -> Geometry:
    """Return the geometry with its length of 1 expressed in the unit of known poses."""
    given = known_poses @ np.linalg.inv(known_poses[geometry.reference])
    path, given_path = (np.linalg.norm(poses[:, :3, 3]) for poses in (geometry.world_to_camera, given))
    return replace(geometry, unit=float(given_path / path) if path > 0 else None)


def _with_missing_poses(world_to_camera: F64, missing: NDArray[np.int64]) -> F64:
    """Interpolate missing poses linearly between their neighbours; beyond the ends, repeat the nearest pose."""
    known = np.setdiff1d(np.arange(len(world_to_camera)), missing)
    at = np.clip(missing, known[0], known[-1])
    poses = world_to_camera.copy()
    turns = Slerp(known, Rotation.from_matrix(poses[known, :3, :3]))
    camera_in_world = np.linalg.inv(poses[known])[:, :3, 3]
    centres = np.stack([np.interp(at, known, camera_in_world[:, k]) for k in range(3)], axis=1)
    poses[missing, :3, :3] = turns(at).as_matrix()
    poses[missing, :3, 3] = -np.einsum("nij,nj->ni", poses[missing, :3, :3], centres)
    return poses
