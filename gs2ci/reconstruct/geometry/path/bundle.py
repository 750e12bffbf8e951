"""Bundle adjustment of poses, points and, on request, one focal length, from given poses; by pycolmap.

Here: tracks and poses into a COLMAP model, its adjustment, and back. Not here: the adjustment without given poses
(`motion`), the judgement of the result (`paper.hierarchy`).
"""

from dataclasses import dataclass
from itertools import islice
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import relative_to
from gs2ci.core.colmap import pycolmap, quietly
from gs2ci.core.errors import GeometryError
from gs2ci.reconstruct.geometry.path.motion import CameraMotion, rays
from gs2ci.reconstruct.geometry.path.telemetry import place_points
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks

# A track with a larger error is wrong, not just inaccurate (the original's filter before its adjustment).
OUTLIER_PX: Final = 8.0
# Sums over several threads differ in their last digits from run to run. An adjustment ends when its error falls by less
# than this share: in ten adjustments, two to three times as many iterations moved the path by at most 1e-4 of its
# extent; noise moves it by 4e-3 and more.
_SOLVER: Final = {"num_threads": 1, "function_tolerance": 1e-8}


@dataclass(frozen=True)
class AdjustedBundle:
    """Poses, [N, 4, 4], and camera matrix, [3, 3], after adjustment."""

    world_to_camera: F64
    intrinsics: F64


def adjust_bundle(
    tracks: Tracks, world_to_camera: F64, intrinsics: F64, huber_px: float, *, refine_focal: bool
) -> AdjustedBundle:
    """Adjust poses and points to all tracks.

    Args:
        tracks: At least one point.
        world_to_camera: Where to start, [N, 4, 4], in any frame and unit.
        intrinsics: Camera matrix in px, [3, 3]; its principal point is fixed.
        huber_px: Residual from which on an observation counts less.
        refine_focal: Whether the focal length is adjusted as well; its two components keep their ratio.

    Returns:
        The adjusted cameras, with the reference view as the world frame; views that see no point keep their pose.

    Raises:
        GeometryError: The poses put the points behind the camera, or no finite solution was found.
    """
    start, kept = place_points(tracks, world_to_camera, intrinsics, huber_px, OUTLIER_PX)
    ahead = start.least_depth > 0
    if not ahead.any():
        raise GeometryError("the poses put every tracked point behind a camera")
    ratio = intrinsics[1, 1] / intrinsics[0, 0]
    model = _model(start, kept, intrinsics, ratio, ahead)
    ceres = {"loss_function_type": "HUBER", "loss_function_scale": huber_px, "solver_options": _SOLVER}
    options = pycolmap.BundleAdjustmentOptions(
        {"print_summary": False, "refine_focal_length": refine_focal, "ceres": ceres}
    )
    config = pycolmap.BundleAdjustmentConfig()
    seeing = [i for i in range(len(world_to_camera)) if kept.seen[ahead, i].any()]
    for i in seeing:
        config.add_image(i + 1)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    with quietly():
        summary = pycolmap.create_default_bundle_adjuster(options, config, model).solve()
    poses = start.world_to_camera.copy()
    for i in seeing:
        poses[i, :3] = model.images[i + 1].cam_from_world().matrix()
    (camera,) = model.cameras.values()
    focal = float(camera.params[0])
    if not summary.is_solution_usable() or not np.isfinite(poses).all() or not 0 < focal < np.inf:
        raise GeometryError("the bundle adjustment found no finite solution")
    adjusted = intrinsics.astype(np.float64).copy()
    adjusted[0, 0], adjusted[1, 1] = focal, focal * ratio
    relative = relative_to(poses, tracks.reference)
    relative[tracks.reference] = np.eye(4)  # exact, without rounding errors
    return AdjustedBundle(relative, adjusted)


def _model(start: CameraMotion, tracks: Tracks, intrinsics: F64, ratio: float, chosen: Any) -> Any:
    """Build a COLMAP model; rows are stretched so that one focal length serves both axes."""
    stretch = np.array([1.0, 1 / ratio])
    centre = intrinsics[:2, 2] * stretch
    model = pycolmap.Reconstruction()
    width, height = (int(np.ceil(2 * c)) for c in centre)
    parameters = [intrinsics[0, 0], *centre]
    camera = pycolmap.Camera(
        camera_id=1, model="SIMPLE_PINHOLE", width=max(width, 1), height=max(height, 1), params=parameters
    )
    model.add_camera_with_trivial_rig(camera)
    positions, seen = tracks.positions[chosen], tracks.seen[chosen]
    for i, pose in enumerate(start.world_to_camera):
        image = pycolmap.Image(name=str(i), camera_id=camera.camera_id, image_id=i + 1)
        image.points2D = [pycolmap.Point2D(point) for point in positions[seen[:, i], i] * stretch]
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    directions = rays(positions[:, tracks.reference], intrinsics)
    index = np.cumsum(seen, axis=0) - 1
    sightings = zip((np.nonzero(seen)[1] + 1).tolist(), index[seen].tolist(), strict=True)
    grey = np.zeros(3, np.uint8)
    for point, times in zip(directions / start.inverse_depth[chosen, None], seen.sum(axis=1).tolist(), strict=True):
        elements = [pycolmap.TrackElement(*sighting) for sighting in islice(sightings, times)]
        model.add_point3D(point, pycolmap.Track(elements), grey)
    return model
