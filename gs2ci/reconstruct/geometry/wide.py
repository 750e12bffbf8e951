"""Geometry from points matched between all pairs of views: wide baselines, in any order.

Corners can be tracked from view to view as long as patches look alike, over a few degrees. If a camera was put at
separate positions in no order, scale-invariant features (SIFT, Lowe 2004) still match between views that see the same
things; the matches that an essential matrix confirms are built into one scene, one view at a time (COLMAP's incremental
mapper, Schönberger and Frahm 2016). From about 15° on, surfaces look foreshortened: features are then also found in
tilted pictures (ASIFT, Morel and Yu 2009), at ten times the time. Here: the features, the pairs, the scene and its
geometry. Not here: when it is used (`choose`, `far_apart`), the sweep (`sweep`).
"""

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import cv2
import numpy as np
import pycolmap

from gs2ci.core.arrays import F32, F64
from gs2ci.core.findings import Code, finding
from gs2ci.reconstruct.geometry.direct import at_rest
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.prior import Request
from gs2ci.reconstruct.geometry.surface_map import surface_map
from gs2ci.reconstruct.geometry.sweep import inverse_depth_range

# Decoded views are blurred: features are detected at twice their size, with equalised local contrast.
_ENLARGED: Final = 2
_MOST_FEATURES: Final = 2000
_LEAST_CONTRAST: Final = 0.01
# Pictures are tilted so many times, each by √2 more (OpenCV's `maxTilt`); and how many of their features are kept in
# all views together, which bounds time and memory for matches.
_STEEPEST: Final = 2
_MOST_TILTED: Final = 64_000
# A match must be mutual, and nearer than this share of the distance to the second nearest feature (Lowe's test).
_RATIO: Final = 0.8
# For a pair: fewest matches that its essential matrix confirms, and their largest error. Decoded photographs 15° apart,
# in which a third of the matches are right, keep 15 to 30.
_LEAST_MATCHES: Final = 15
_MATCH_PX: Final = 2.0
# For the scene: fewest points that a view needs to join, and largest errors and least angles of its points.
_LEAST_POINTS_TO_JOIN: Final = 12
_LEAST_TO_BEGIN: Final = 30
_JOIN_PX: Final = 4.0
_POINT_PX: Final = 3.0
_LEAST_ANGLE_TO_BEGIN_DEG: Final = 2.0
_LEAST_ANGLE_DEG: Final = 0.5
_EPSILON: Final = 1e-6
_SEED: Final = 0


@dataclass(frozen=True)
class _Scene:
    """Poses, [N, 4, 4], points in the world, [P, 3], and their reprojection error."""

    world_to_camera: F64
    points: F64
    rms_px: float


def wide_motion(request: Request, found: Geometry, *, tilted: bool = False) -> Geometry:
    """Estimate poses and depth from features matched between all pairs of views.

    Args:
        request: Its views are used.
        found: The tracks' geometry, of which the camera matrix and the middle view are used.
        tilted: Whether features are found in tilted pictures, too.

    Returns:
        A geometry with the verdict "full"; one at rest, "unsupported", if not every view joins one scene or too few
        points confirm it. A finding says how many views joined, if any did.
    """
    scene, joined = _grown(request.views, found.intrinsics, tilted=tilted)
    still = at_rest(found)
    if scene is None:
        partly = (finding(Code.VIEWS_JOIN_IN_PART, joined=joined, views=len(request.views)),) if joined else ()
        return replace(still, notes=(*still.notes, *partly))
    relative = scene.world_to_camera @ np.linalg.inv(scene.world_to_camera[found.reference])
    to_reference = scene.world_to_camera[found.reference]
    depths = scene.points @ to_reference[2, :3] + to_reference[2, 3]
    ahead = 1 / depths[depths > 0]
    if len(ahead) < request.settings.criteria.tracks or 2 * len(ahead) < len(depths):
        return still
    unit = float(np.median(ahead))
    relative[:, :3, 3] *= unit
    settings = request.settings.sweep
    span = inverse_depth_range(ahead / unit, settings)
    depth = surface_map(request.views, relative, still.intrinsics, still.reference, span, settings, edges=False)
    return replace(
        still,
        world_to_camera=relative,
        inverse_depth=depth,
        tracks=len(scene.points),
        reprojection_rms_px=scene.rms_px,
        verdict="full",
        notes=(*_of_camera(found), finding(Code.WIDE_MOTION, points=len(scene.points))),
    )


def _of_camera(found: Geometry) -> tuple[Any, ...]:
    """Keep the notes on the camera matrix; those on missing tracks no longer matter."""
    return tuple(note for note in found.notes if note.code.name.startswith("FOCAL"))


def _grown(views: F32, intrinsics: F64, *, tilted: bool) -> tuple[_Scene | None, int]:
    """Build one scene from all pairs, None unless every view joins it; and return how many views joined."""
    features = [_features(view, _MOST_TILTED // len(views) if tilted else None) for view in views]
    pairs = {
        (i, j): matches
        for i, j in itertools.combinations(range(len(views)), 2)
        if len(matches := _matches(features[i][1], features[j][1])) >= _LEAST_MATCHES
    }
    size = (views.shape[1], views.shape[2])
    with TemporaryDirectory() as folder, _quietly():
        database = Path(folder) / "features.db"
        _write(database, [places for places, _ in features], pairs, intrinsics, size)
        models = pycolmap.incremental_mapping(database, Path(folder), Path(folder) / "models", _mapping())
        largest = max(models.values(), key=lambda model: model.num_reg_images(), default=None)
        joined = 0 if largest is None else largest.num_reg_images()
        return (_taken(largest, len(views)) if joined == len(views) else None), joined


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
    likeness = one @ other.T
    rows = np.arange(len(one))
    nearest = likeness.argmax(axis=1)
    mutual = likeness.argmax(axis=0)[nearest] == rows
    best = likeness[rows, nearest]
    likeness[rows, nearest] = -1
    distance, second = (np.sqrt(np.maximum(2 - 2 * value, 0)) for value in (best, likeness.max(axis=1)))
    kept = mutual & (distance < _RATIO * second)
    return np.stack([rows[kept], nearest[kept]], axis=1).astype(np.uint32)


def _write(
    path: Path, places: list[F32], pairs: dict[tuple[int, int], Any], intrinsics: F64, size: tuple[int, int]
) -> None:
    """Write the mapper's input: one camera, an image for each view, and the matches that essential matrices confirm."""
    parameters = [intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2]]
    camera = pycolmap.Camera(model="PINHOLE", width=size[1], height=size[0], params=parameters)
    camera.has_prior_focal_length = True
    database = pycolmap.Database.open(path)
    try:
        camera.camera_id = database.write_camera(camera)
        rig = pycolmap.Rig()
        rig.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera.camera_id))
        rig_id, ids = database.write_rig(rig), []
        for number, at in enumerate(places):
            image = pycolmap.Image(name=f"{number:06d}", camera_id=camera.camera_id)
            image.image_id = database.write_image(image)
            frame = pycolmap.Frame()
            frame.rig_id = rig_id
            frame.add_data_id(image.data_id)
            database.write_frame(frame)
            database.write_keypoints(image.image_id, at)
            ids.append(image.image_id)
        options = pycolmap.TwoViewGeometryOptions()
        options.min_num_inliers, options.ransac.max_error, options.ransac.random_seed = _LEAST_MATCHES, _MATCH_PX, _SEED
        for (i, j), matches in pairs.items():
            one, other = (places[k].astype(np.float64) for k in (i, j))
            geometry = pycolmap.estimate_calibrated_two_view_geometry(camera, one, camera, other, matches, options)
            database.write_matches(ids[i], ids[j], matches)
            database.write_two_view_geometry(ids[i], ids[j], geometry)
    finally:
        database.close()


def _mapping() -> Any:
    options = pycolmap.IncrementalPipelineOptions()
    options.min_num_matches, options.multiple_models, options.extract_colors = _LEAST_MATCHES, False, False
    # Sums over several threads differ in their last digits from run to run.
    options.num_threads, options.random_seed = 1, _SEED
    options.ba_refine_focal_length = options.ba_refine_extra_params = False
    mapper = options.mapper
    mapper.init_min_num_inliers, mapper.init_min_tri_angle = _LEAST_TO_BEGIN, _LEAST_ANGLE_TO_BEGIN_DEG
    mapper.abs_pose_min_num_inliers, mapper.abs_pose_max_error = _LEAST_POINTS_TO_JOIN, _JOIN_PX
    mapper.init_max_error = mapper.filter_max_reproj_error = _POINT_PX
    mapper.filter_min_tri_angle = options.triangulation.min_angle = _LEAST_ANGLE_DEG
    options.triangulation.complete_max_reproj_error = options.triangulation.merge_max_reproj_error = _POINT_PX
    return options


def _taken(model: Any, views: int) -> _Scene:
    poses = np.tile(np.eye(4), (views, 1, 1))
    for image in model.images.values():
        poses[int(image.name), :3] = image.cam_from_world().matrix()
    points = np.array([point.xyz for point in model.points3D.values()]).reshape(-1, 3)
    return _Scene(poses, points, float(model.compute_mean_reprojection_error()))


@contextmanager
def _quietly() -> Iterator[None]:
    """Keep the mapper's messages off the terminal, since its result is checked here."""
    level, aloud = pycolmap.logging.minloglevel, pycolmap.logging.logtostderr
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
    try:
        yield
    finally:
        pycolmap.logging.minloglevel, pycolmap.logging.logtostderr = level, aloud
