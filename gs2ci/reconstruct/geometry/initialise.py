"""From decoded views to camera path and depth: tracks, motion, plane sweep, and the fallbacks, on one page.

Here: the order of the steps and the fallbacks. Not here: any step itself. `gs2ci.reconstruct.pipeline` and the fit
import `Geometry` and `initialise` from this file.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from gs2ci.core.arrays import F32, F64, I64, Bool, Size
from gs2ci.core.bounds import Bounded
from gs2ci.core.cameras import relative_to, rigid
from gs2ci.core.errors import GeometryError
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.core.lens import slopes_of
from gs2ci.core.progress import Progress, Silent, said
from gs2ci.reconstruct.choices import LeftOut
from gs2ci.reconstruct.geometry.depth.sweep import (
    LEAST_PLANES,
    SweepSettings,
    SweptViews,
    first_of,
    inverse_depth_range,
    sweep,
)
from gs2ci.reconstruct.geometry.depth.view_depths import ViewDepth
from gs2ci.reconstruct.geometry.kinds import ESTIMATED, GIVEN, PathSource, Verdict
from gs2ci.reconstruct.geometry.path.bundle import adjust_bundle
from gs2ci.reconstruct.geometry.path.focal import Focal, FocalSettings, default_focal, estimate_focal
from gs2ci.reconstruct.geometry.path.halves import expected_path_error, times_better_foretold
from gs2ci.reconstruct.geometry.path.motion import (
    CameraMotion,
    MotionSettings,
    adjust,
    at_unit_depth,
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
        path_error_expected: Expected error of the path as a share of its extent, from halves of the tracks; None if it
            was given, or there is none.
        unit: A length of 1 in the unit of the given poses; None if none were given, or they were not used.
        order_errors: By how many standard errors the tracks prefer this order of depth to the reverse
            (`motion.preference`); None without tracks, or if they have no second solution.
        other_order: The tracks' solution in the reverse order of depth; None if there is none, or poses were given.
        pose_errors: Standard errors of the poses, for a prior on them; None if they were not given, or the tracks
            contradict them.
        order_given: Whether a stage settles the order of depth: tracked points lie in front of its cameras, not behind.
        view_depths: Depths of the reference view and of others, if the path turns far; otherwise none.
        followed: Where each view shows the tracked points that the motion explains, as slopes, [P, N, 2], NaN where one
            is not seen; None if it does not come from tracks.
    """

    world_to_camera: F64
    intrinsics: F64
    focal_source: str
    inverse_depth: F32
    reference: int
    tracks: int = 0
    reprojection_rms_px: float = 0.0
    parallax_px: float = 0.0
    verdict: Verdict = Verdict.UNSUPPORTED
    notes: Findings = ()
    source: str = PathSource.TRACKS
    path_error_expected: float | None = None
    unit: float | None = None
    order_errors: float | None = None
    other_order: "OtherOrder | None" = None
    pose_errors: PoseErrors | None = None
    order_given: bool = False
    view_depths: tuple[ViewDepth, ...] = ()
    followed: F64 | None = None

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
        InputError: The settings make no sense.
        GeometryError: The known poses contradict the tracks.
    """
    progress = progress or Silent()
    progress.stage("geometry", 3)
    found = _Estimation(views, (settings or GeometrySettings()).check(), seen, known_poses).run(intrinsics, progress)
    progress.step(3)
    said(found.notes, progress)
    return found


def flat_geometry(views: int, size: Size, camera: Focal) -> Geometry:
    """Return the assumption without an estimate: a camera at rest in front of a plane at inverse depth 1."""
    return Geometry(
        world_to_camera=rigid(np.eye(3), np.zeros((views, 3))),
        intrinsics=camera.intrinsics,
        focal_source=camera.source,
        inverse_depth=np.ones(size, np.float32),
        reference=views // 2,
        notes=camera.notes,
    )


def usable_tracks(views: F32, settings: GeometrySettings, seen: Bool | None = None) -> Tracks:
    """Find the tracks that a geometry may be based on, from the corners of the middle view; there may be none."""
    return _Estimation(views, settings, seen).tracks


@dataclass(frozen=True)
class _Found:
    """A geometry, and the motion and the explained tracks that it is based on."""

    geometry: Geometry
    motion: CameraMotion
    tracks: Tracks


class _Estimation:
    """The steps from views to a geometry.

    Args:
        views: As for `initialise`.
        settings: Of every step.
        seen: As for `initialise`.
        poses: Those that are known, as for `initialise`.
    """

    def __init__(self, views: F32, settings: GeometrySettings, seen: Bool | None, poses: F64 | None = None) -> None:
        self.views, self.settings, self.seen, self.poses = views, settings, seen, poses
        self.size, self.reference = (views.shape[1], views.shape[2]), len(views) // 2
        self.corners = find_corners(views, self.reference, settings.tracks)
        self.tracks = self.usable(find_tracks(views, self.reference, self.corners, settings.tracks))

    def usable(self, tracks: Tracks) -> Tracks:
        """Keep tracks that most views see, and drop the views that too few tracks reach."""
        tracks = tracks if self.seen is None else within(tracks, self.seen)
        long = tracks.seen_by_at_least(max(2, int(np.ceil(_LEAST_SHARE_OF_VIEWS * len(self.views)))))
        positions = long.positions.copy()
        positions[:, ~supported_views(long, self.settings.criteria)] = np.nan
        return Tracks(positions, tracks.reference).seen_by_at_least(2)

    def run(self, intrinsics: F64 | None, progress: Progress) -> Geometry:
        """Do all steps."""
        progress.step(1, tracks=len(self.tracks))
        doubts = doubts_about_tracks(self.tracks, self.size, self.settings.criteria)
        self.flat = flat_geometry(len(self.views), self.size, known_focal(intrinsics) or self.focal(doubts))
        if doubts:
            return replace(self.flat, notes=(*self.flat.notes, *doubts, PLANE_NOTE))
        found = self.found_twice(moved=self.poses is not None)
        if found.geometry.verdict in (Verdict.ROTATION_ONLY, Verdict.STATIC):
            moved = self.found_twice(moved=True)
            found = moved if self.halves_agree(moved) else found
        geometry = found.geometry
        progress.step(2, tracks=geometry.tracks, rms_px=geometry.reprojection_rms_px)
        if not geometry.has_path:
            return geometry
        geometry = self.doubted(found) if self.poses is None else measured(geometry, self.poses)
        followed = slopes_of(found.tracks.positions, geometry.intrinsics)
        geometry = replace(geometry, inverse_depth=self.depth(geometry, found.motion), followed=followed)
        return self.with_reverse(replace(found, geometry=geometry))

    def focal(self, doubts: Findings) -> Focal:
        """Estimate the focal length, if there are no doubts about the tracks."""
        settings = self.settings
        if doubts:
            return default_focal(self.size, "too few points could be tracked to estimate it", settings.focal)
        return estimate_focal(self.tracks, self.size, settings.focal, settings.motion)

    def found_twice(self, *, moved: bool) -> _Found:
        """Estimate the camera's motion, and again from new tracks that start where the first estimate predicts them.

        Args:
            moved: Whether the camera is known to have moved; otherwise the tracks must show it.
        """
        tracks, found = self.tracks, self.found(self.tracks, moved=moved)
        if not found.geometry.has_path:
            return found
        if LeftOut.TRACKS_SOUGHT_TWICE not in self.settings.left_out:
            again = self.second_look(found)
            if again is not None and (second := self.found(again, moved=moved)).geometry.has_path:
                tracks, found = again, second
        if self.poses is not None or LeftOut.ADJUSTMENT_OF_POINTS in self.settings.left_out:
            return found
        return self.freed(found, len(tracks), moved=moved)

    def halves_agree(self, found: _Found) -> bool:
        """Tell whether halves of the tracks give the same path, as they do if the camera moved.

        If a path comes from the tracks' errors, each half gives a different one.
        """
        geometry, criteria = found.geometry, self.settings.criteria
        if not geometry.has_path or geometry.parallax_px < criteria.parallax_px:
            return False
        return halves_agree(self.expected_error(found), criteria)

    def found(self, tracks: Tracks, *, moved: bool) -> _Found:
        """Estimate the camera's motion from all tracks, or place the points of those that agree with known poses."""
        if self.poses is not None:
            return self.judged(len(tracks), *self.placed(tracks, self.poses), moved=True)
        motion, kept = estimate_motion(tracks, self.flat.intrinsics, self.settings.motion)
        return self.judged(len(tracks), motion, kept, moved=moved)

    def placed(self, tracks: Tracks, poses: F64) -> tuple[CameraMotion, Tracks]:
        """Place the points of tracks by known poses."""
        how = self.settings.motion
        return place_points(tracks, poses, self.flat.intrinsics, how.huber_px, how.outlier_px)

    def freed(self, found: _Found, candidates: int, *, moved: bool) -> _Found:
        """Adjust again with points that may leave the rays of their corners; return `found` if that fails.

        The positions in the middle view have errors like all others, most of all from the residue of its mask. Over 38
        first geometries this adjustment lowered the error of the path by 15 % and that of rotations by 11 % in the
        geometric mean, and by half in the scene whose cameras go forward (`python -m tests.benchmarks path_error`). It
        needs a start near its minimum.
        """
        start, huber_px = found.motion.world_to_camera, self.settings.motion.huber_px
        try:
            bundle = adjust_bundle(found.tracks, start, self.flat.intrinsics, huber_px, refine_focal=False)
            motion, kept = self.placed(found.tracks, bundle.world_to_camera)
        except GeometryError:
            return found
        freed = self.judged(candidates, motion, kept, moved=moved)
        return freed if freed.geometry.has_path else found

    def second_look(self, found: _Found) -> Tracks | None:
        """Track all corners again, starting where a rough depth map predicts them; None if that fails.

        On fourteen decoded scenes this lowered the error of the path by 5 % and that of rotations by 9 %; where only
        few tracks had been found, it doubled their number.
        """
        settings, geometry = self.settings.sweep, found.geometry
        rough = replace(
            settings,
            planes=max(settings.planes // 2, LEAST_PLANES),
            most_pixels=min(settings.most_pixels, self.views[0, ..., 0].size) // 4,
        )
        span = inverse_depth_range(found.motion.inverse_depth, rough)
        depth = sweep(self.views, geometry.world_to_camera, geometry.intrinsics, self.reference, span, rough)
        at = self.corners.astype(int)
        predicted = predict_positions(
            self.corners, depth[at[:, 1], at[:, 0]].astype(np.float64), geometry.world_to_camera, geometry.intrinsics
        )
        again = self.usable(refine_tracks(self.views, self.reference, predicted, self.settings.tracks))
        loses_views = again.seen.any(axis=0).sum() < self.tracks.seen.any(axis=0).sum()
        doubted = loses_views or doubts_about_tracks(again, self.size, self.settings.criteria)
        return None if doubted else again

    def depth(self, geometry: Geometry, motion: CameraMotion) -> F32:
        """Return the depth along the path of a geometry, in the range of a motion's points."""
        settings = self.settings.sweep
        span = inverse_depth_range(motion.inverse_depth, settings)
        poses, intrinsics = geometry.world_to_camera, geometry.intrinsics
        order = first_of(len(poses), self.reference)
        return self.swept.depth(order, poses[order], intrinsics, span)

    @cached_property
    def swept(self) -> SweptViews:
        """Get the views as sweeps compare them."""
        return SweptViews(self.views, self.settings.sweep)

    def judged(self, candidates: int, motion: CameraMotion, tracks: Tracks, *, moved: bool) -> _Found:
        """Return a geometry with the motion, with its rotations alone, or only with the reason why neither is used.

        If the camera is known to have moved, its whole motion is used unless the tracks contradict it, however small
        the parallax. Given poses are kept for views that see too few tracks as well.
        """
        flat, criteria = self.flat, self.settings.criteria
        rotations = fit_rotations(tracks, flat.intrinsics, self.settings.motion)
        if moved:
            reasons = contradictions(candidates, tracks, motion, criteria)
            verdict: Verdict = Verdict.UNSUPPORTED if reasons else Verdict.FULL
        else:
            verdict, reasons = classify_motion(candidates, tracks, motion, rotations, criteria)
        notes = (*flat.notes, *reasons, *(() if verdict == Verdict.FULL else (PLANE_NOTE,)))
        poses = flat.world_to_camera.copy()
        if verdict == Verdict.FULL:
            poses = motion.world_to_camera
        elif verdict == Verdict.ROTATION_ONLY:
            poses[:, :3, :3] = rotations.rotations
        missing = np.flatnonzero(~tracks.seen.any(0))
        if len(missing) and (verdict == Verdict.ROTATION_ONLY or (verdict == Verdict.FULL and self.poses is None)):
            poses = _with_missing_poses(poses, missing)
            notes = (*notes, finding(Code.POSES_INTERPOLATED, views=missing.tolist()))
        geometry = replace(
            flat,
            world_to_camera=poses,
            tracks=len(tracks),
            reprojection_rms_px=motion.rms_px,
            parallax_px=parallax_px(motion, rotations),
            verdict=verdict,
            notes=notes,
        )
        return _Found(geometry, motion, tracks)

    def doubted(self, found: _Found) -> Geometry:
        """Return the geometry with the expected error of its path."""
        error = self.expected_error(found)
        notes = (*found.geometry.notes, *doubts_about_path(error, self.settings.criteria))
        return replace(found.geometry, path_error_expected=error, notes=notes)

    def expected_error(self, found: _Found) -> float | None:
        """Return the expected error of a path; see `halves`."""
        return expected_path_error(found.motion, found.tracks, self.flat.intrinsics, self.size, self.settings.motion)

    def with_reverse(self, found: _Found) -> Geometry:
        """Add how sure tracks are of the order of depth and, if they are not, their solution in the reverse order.

        Both motions are adjusted in the same way, each from a start near the other's reversal, so that the comparison
        is fair.
        """
        geometry, how, posed = found.geometry, self.settings.motion, self.poses is not None
        here = adjust(found.tracks, geometry.intrinsics, how, start=found.motion)
        if posed and self.borne_out(found, here):
            geometry = replace(geometry, pose_errors=errors_of_given(geometry.world_to_camera, geometry.intrinsics))
        there = adjust(found.tracks, geometry.intrinsics, how, start=reversed_depth(here))
        if np.corrcoef(here.inverse_depth, there.inverse_depth)[0, 1] >= 0:
            return geometry  # the reversal is no minimum of its own
        errors = preference(here, there, how.huber_px)
        known = replace(geometry, order_errors=errors)
        if posed or errors >= self.settings.criteria.order_errors or np.median(there.inverse_depth) <= 0:
            return known
        there = at_unit_depth(there)
        missing = np.flatnonzero(~found.tracks.seen.any(0))
        poses = _with_missing_poses(there.world_to_camera, missing) if len(missing) else there.world_to_camera
        reverse = replace(geometry, world_to_camera=poses, reprojection_rms_px=there.rms_px)
        return replace(known, other_order=OtherOrder(poses, self.depth(reverse, there), there.rms_px))

    def borne_out(self, found: _Found, adjusted: CameraMotion) -> bool:
        """Tell whether tracks contradict given poses no more than their own noise explains.

        Positions off by 5 % of the path are contradicted in two scenes of four; if tracks are few or the camera moves
        forward, they are not (scenes of `python -m tests.benchmarks given_poses`).
        """
        how, intrinsics = self.settings.motion, self.flat.intrinsics
        times = times_better_foretold(found.motion, adjusted, found.tracks, intrinsics, self.size, how)
        return times <= _CONTRADICTED


def known_focal(intrinsics: F64 | None) -> Focal | None:
    """Return the camera matrix of a file, [3, 3]; None if there is none."""
    return None if intrinsics is None else Focal(intrinsics.astype(np.float64), "file")


def measured(geometry: Geometry, known_poses: F64) -> Geometry:
    """Return the geometry with its length of 1 expressed in the unit of known poses."""
    given = relative_to(known_poses, geometry.reference)
    path, given_path = (np.linalg.norm(poses[:, :3, 3]) for poses in (geometry.world_to_camera, given))
    return replace(geometry, unit=float(given_path / path) if path > 0 else None)


def _with_missing_poses(world_to_camera: F64, missing: I64) -> F64:
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
