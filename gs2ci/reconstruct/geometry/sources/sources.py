"""Sources of first poses that need no model: tracks, matches, displacements, the stage, a file, rest.

Here: these six. Not here: a learned source (`vggt`), the choice among them (`choose`), tracks and depth themselves
(`initialise`).
"""

from dataclasses import replace
from pathlib import Path
from typing import Final

from gs2ci.core.arrays import F64
from gs2ci.core.errors import GeometryError
from gs2ci.core.findings import Code, Findings, finding
from gs2ci.core.foreign.camera_files import CameraFile, read_cameras
from gs2ci.core.progress import Progress
from gs2ci.reconstruct.geometry.depth.sweep import inverse_depth_range, sweep
from gs2ci.reconstruct.geometry.initialise import Geometry, flat_geometry, initialise, known_focal, measured
from gs2ci.reconstruct.geometry.kinds import PathSource, Verdict
from gs2ci.reconstruct.geometry.path.focal import default_focal
from gs2ci.reconstruct.geometry.path.telemetry import errors_of_given, poses_of_stage, stated_error
from gs2ci.reconstruct.geometry.prior import Request, from_tracks
from gs2ci.reconstruct.geometry.sources.direct import swept_along
from gs2ci.reconstruct.geometry.sources.displaced import displaced_motion, say_how_found
from gs2ci.reconstruct.geometry.sources.wide import ahead_of, wide_motion

# From this relative difference on, the report mentions that two focal lengths differ.
_FOCAL_DOUBT: Final = 0.05


def from_stage(request: Request, progress: Progress) -> Geometry:
    """Find the geometry along the poses that the stage reported.

    Its poses settle the order of depth: points in front of its cameras would lie behind those of the reversed path,
    unless it turned by exactly as much as the reversal requires.
    """
    poses = poses_of_stage(request.shot)
    found = initialise(request.views, request.intrinsics, request.settings, progress, poses, request.seen)
    if not found.tracks:
        found = _without_tracks(request, poses, found)
    shot = request.shot
    held = _held(found, PathSource.STAGE, stated_error(shot, "position_error"), stated_error(shot, "turn_error_deg"))
    return replace(held, order_given=held.has_path)


def _held(found: Geometry, source: PathSource, error: float | None = None, turn_deg: float | None = None) -> Geometry:
    """Add the standard errors of given poses, within which the fit refines them, and whether tracks contradict them.

    Without them a fit of a small motion exchanges turning for travel, which views hardly show.

    Args:
        found: With given poses.
        source: Who gave them.
        error: Standard error of positions in their unit; None if it is not stated.
        turn_deg: Of a turn in step with the travel; None if it is not stated.
    """
    found = replace(found, source=source)
    if not found.has_path:
        return found
    if found.tracks > 0 and found.pose_errors is None:
        # If tracks contradict the poses, they contradict the stated error too.
        errors = errors_of_given(found.world_to_camera, found.intrinsics).loosened()
        note = finding(Code.POSES_CONTRADICTED, source=source)
        return replace(found, pose_errors=errors, notes=(note, *found.notes))
    position = None if error is None or found.unit is None else error / found.unit
    return replace(found, pose_errors=errors_of_given(found.world_to_camera, found.intrinsics, position, turn_deg))


def from_displacements(request: Request, progress: Progress) -> Geometry:
    """Find the motion that explains the displacements of blocks of the measurement."""
    found = displaced_motion(request, from_tracks(request, progress))
    say_how_found(found, progress)
    return found


def from_rest(request: Request, progress: Progress) -> Geometry:
    """Return a camera at rest, as the user says: no path, and no depth."""
    progress.stage("geometry", 1)
    note = finding(Code.CAMERA_GIVEN_AT_REST)
    why, focal = "a camera at rest does not show it", request.settings.focal
    # Nothing depends on the field of view.
    camera = known_focal(request.intrinsics) or default_focal(request.size, why, focal)
    found = flat_geometry(len(request.views), request.size, replace(camera, notes=(note,)))
    progress.step(1)
    progress.say(note.sentence)
    return replace(found, verdict=Verdict.STATIC, source=PathSource.REST)


def from_wide(request: Request, progress: Progress) -> Geometry:
    """Find the path by features matched between all pairs of views, which may lie far apart and in no order.

    Raises:
        GeometryError: The views do not all join one scene, or their depths along its path do not agree; or pycolmap
            cannot be had.
    """
    found = wide_motion(request, from_tracks(request, progress))
    if not found.has_path:
        raise GeometryError(
            "features matched between all pairs of views do not join them into one scene, or their depths disagree",
            remedy="use another source: tracks, stage or file:PATH, or more light and fewer masks",
        )
    return found


def from_file(path: Path, request: Request, progress: Progress) -> Geometry:
    """Find the geometry along the cameras of a COLMAP model's folder or a transforms.json.

    The tracks give the scale of the depths; if there are too few of them, the file's points do, otherwise the
    measurement.
    """
    cameras = read_cameras(path, request.shot.views, request.shot.size, request.shot.distortion)
    notes = _focal_notes(cameras.intrinsics, request.shot.intrinsics, straight=request.lens is None)
    if request.lens is not None:
        cameras = replace(cameras, intrinsics=request.lens.canvas_intrinsics)
    poses = cameras.world_to_camera
    found = initialise(request.views, cameras.intrinsics, request.settings, progress, poses, request.seen)
    # One view shows no depth, even within a known range.
    if not found.has_path and len(cameras.points) and len(poses) > 1:
        found = swept_between_points(request, cameras, found)
    elif not found.tracks:
        found = _without_tracks(request, poses, found)
    held = _held(found, PathSource.FILE)
    return replace(held, notes=(*notes, *held.notes))


def _without_tracks(request: Request, poses: F64, found: Geometry) -> Geometry:
    """Estimate the depths along given poses from the measurement, if there are too few tracks."""
    swept = swept_along(request, found, poses) if len(poses) > 1 else None
    if swept is None:
        return replace(found, notes=(*found.notes, finding(Code.POSES_NOT_BORNE_OUT)))
    return replace(measured(swept, poses), notes=(*swept.notes, finding(Code.DEPTH_RANGE_FOUND)))


def swept_between_points(request: Request, cameras: CameraFile, without: Geometry) -> Geometry:
    """Sweep depth between the nearest and farthest points of a file.

    Args:
        request: Its views.
        cameras: With points.
        without: The tracks' geometry, whose notes say why they did not suffice.

    Raises:
        GeometryError: The points lie behind the middle camera.
    """
    reference, settings = without.reference, request.settings.sweep
    poses, ahead, unit = ahead_of(cameras.world_to_camera, cameras.points, reference)
    count = len(cameras.points)
    if 2 * len(ahead) < count:
        raise GeometryError(
            f"{count - len(ahead)} of the file's {count} points lie behind the middle camera",
            remedy="check that its poses are world-to-camera with OpenCV axes",
        )
    span = inverse_depth_range(ahead, settings)
    return replace(
        without,
        world_to_camera=poses,
        intrinsics=cameras.intrinsics,
        inverse_depth=sweep(request.views, poses, cameras.intrinsics, reference, span, settings),
        verdict=Verdict.FULL,
        unit=1 / unit,
        notes=(*without.notes, finding(Code.POSES_UNCHECKED)),
    )


def _focal_notes(of_file: F64, of_shot: F64 | None, *, straight: bool) -> Findings:
    """Report which focal length is used if they differ: with a lens the shot's, which was measured with the lens."""
    if of_shot is None or abs(of_file[0, 0] / of_shot[0, 0] - 1) <= _FOCAL_DOUBT:
        return ()
    code = Code.FOCAL_OF_CAMERA_FILE if straight else Code.FOCAL_OF_SHOT
    return (finding(code, of_file_px=float(of_file[0, 0]), of_shot_px=float(of_shot[0, 0])),)
