"""One scene from features matched between pairs of views, grown from several pairs: COLMAP's incremental mapper.

    matches ─► essential matrices ─► (for each of the strongest pairs: two views ─► one view more ─► …) ─► the scenes

A scene grows from one pair of views, one view at a time (Schönberger and Frahm 2016, by pycolmap). In a narrow field of
view a pair often allows two orders of depth, and a scene that began with the wrong one keeps it: of ten scenes of the
same matches, all joined by every view, six had a wrong path. They explain fewer matches. So scenes are grown from the
pairs with the most confirmed matches, and the one that explains most is the best
(docs/decisions/wide-baseline.md).

Here: the scenes and their expected error. Not here: features and their matches (`wide`), depth.
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import F32, F64, Bool, Size
from gs2ci.core.cameras import camera_centres, path_extent, rigid
from gs2ci.core.colmap import colmap_camera, pycolmap, quietly
from gs2ci.reconstruct.geometry.path.halves import error_from_halves, squared_distance
from gs2ci.reconstruct.threads import in_threads

# Fewest matches of a pair that its essential matrix confirms. Decoded photographs 15° apart, in which a third of the
# matches are right, keep 15 to 30.
LEAST_MATCHES: Final = 15
"""Fewest matches of a pair of views that are used."""
# Sums over several threads differ in their last digits from run to run.
_REPEATABLE: Final = {"random_seed": 0, "num_threads": 1}
# Errors in px, angles in degrees. A pair that begins no scene would be tried again and again, for minutes. And a view
# that sees too few points could be placed by its matches with single views: it took half a minute, and all eight paths
# of a set of photographs that were completed in this way were wrong.
_GROWING: Final = {
    **_REPEATABLE,
    "min_num_matches": LEAST_MATCHES,
    "multiple_models": False,
    "extract_colors": False,
    "init_num_trials": 1,
    "ba_refine_focal_length": False,
    "ba_refine_extra_params": False,
    "structure_less_registration_fallback": False,
    "mapper": {
        "init_min_num_inliers": 30,
        "init_min_tri_angle": 2.0,
        "init_max_error": 3.0,
        "abs_pose_min_num_inliers": 12,
        "abs_pose_max_error": 4.0,
        "filter_max_reproj_error": 3.0,
        "filter_min_tri_angle": 0.5,
    },
    "triangulation": {"min_angle": 0.5, "complete_max_reproj_error": 3.0, "merge_max_reproj_error": 3.0},
}
# An adjustment ends when its error falls by less than this share.
_ADJUSTING: Final = {
    "refine_focal_length": False,
    "refine_principal_point": False,
    "refine_extra_params": False,
    "print_summary": False,
    "ceres": {"solver_options": {"num_threads": 1, "function_tolerance": 1e-6}},
}
# Scenes are grown from so many pairs. In two of three sets of photographs the strongest pair led to a wrong path; the
# right one was found from one of the five strongest.
_MOST_STARTS: Final = 12
# Scenes that explain at least this share of the best one's matches are its rivals: wrong paths explained up to 98 % of
# them in two sets of photographs, and up to 68 % in a third.
_RIVALS: Final = 0.97

Pairs = Mapping[tuple[int, int], np.ndarray[Any, np.dtype[np.uint32]]]
"""For pairs of views, the indices of features that match, [M, 2]."""


@dataclass(frozen=True)
class MappedScene:
    """Cameras and points that explain matches between all views.

    Args:
        world_to_camera: Poses, [N, 4, 4].
        points: In the world, [P, 3].
        rms_px: Mean reprojection error.
        path_error_expected: Expected error of the path, as a share of its extent: the larger of what halves of the
            points show and how far a path is that explains hardly fewer matches. None for a camera that stays in place.
    """

    world_to_camera: F64
    points: F64
    rms_px: float
    path_error_expected: float | None


def grown_scene(places: Sequence[F32], pairs: Pairs, intrinsics: F64, size: Size) -> MappedScene | None:
    """Grow scenes from the strongest pairs, and return the one that explains most matches.

    Args:
        places: Of the features of each view, [F, 2] px.
        pairs: Matches of at least `LEAST_MATCHES`.
        intrinsics: Camera matrix in px, [3, 3].
        size: Height and width of the views, px.

    Returns:
        The scene; None if no scene was joined by every view.
    """
    with TemporaryDirectory() as folder, quietly():
        database = Path(folder) / "features.db"
        ids, confirmed = _write(database, places, pairs, intrinsics, size)
        strongest = sorted(confirmed, key=lambda pair: -confirmed[pair])[:_MOST_STARTS]
        starts = [(ids[i], ids[j]) for i, j in strongest if confirmed[i, j] >= LEAST_MATCHES]
        models = [model for model in in_threads(lambda start: _grown(database, *start), starts) if model is not None]
        whole = sorted((model for model in models if model.num_reg_images() == len(places)), key=_sightings)
        return _scene(whole.pop(), whole, len(places)) if whole else None


def _write(
    path: Path, places: Sequence[F32], pairs: Pairs, intrinsics: F64, size: Size
) -> tuple[list[int], dict[tuple[int, int], int]]:
    """Write the mapper's input: one camera, an image for each view, and the matches that essential matrices confirm.

    Returns:
        The images' ids; and for each pair the number of matches confirmed.
    """
    camera = colmap_camera(intrinsics, size)
    camera.has_prior_focal_length = True
    database = pycolmap.Database.open(path)
    try:
        camera.camera_id = database.write_camera(camera)
        rig = pycolmap.Rig()
        rig.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera.camera_id))
        rig_id, ids, confirmed = database.write_rig(rig), [], {}
        for number, at in enumerate(places):
            image = pycolmap.Image(name=f"{number:06d}", camera_id=camera.camera_id)
            image.image_id = database.write_image(image)
            frame = pycolmap.Frame()
            frame.rig_id = rig_id
            frame.add_data_id(image.data_id)
            database.write_frame(frame)
            database.write_keypoints(image.image_id, at)
            ids.append(image.image_id)

        def confirm(pair: tuple[int, int]) -> Any:
            one, other = (places[k].astype(np.float64) for k in pair)
            # A pair with fewer right matches than are needed is not used, however long they are sought.
            right = min(1.0, LEAST_MATCHES / len(pairs[pair]))
            ransac = {"max_error": 2.0, "random_seed": _REPEATABLE["random_seed"], "min_inlier_ratio": right}
            options = pycolmap.TwoViewGeometryOptions({"min_num_inliers": LEAST_MATCHES, "ransac": ransac})
            return pycolmap.estimate_calibrated_two_view_geometry(camera, one, camera, other, pairs[pair], options)

        for ((i, j), matches), geometry in zip(pairs.items(), in_threads(confirm, pairs), strict=True):
            database.write_matches(ids[i], ids[j], matches)
            database.write_two_view_geometry(ids[i], ids[j], geometry)
            confirmed[i, j] = len(geometry.inlier_matches)
    finally:
        database.close()
    return ids, confirmed


def _grown(database: Path, first: int, second: int) -> Any | None:
    """Grow a scene from two images; None if they do not begin one."""
    options = pycolmap.IncrementalPipelineOptions({**_GROWING, "init_image_id1": first, "init_image_id2": second})
    with TemporaryDirectory() as folder:
        # A database that one thread opens is locked for the others.
        own = Path(shutil.copy(database, folder))
        models = pycolmap.incremental_mapping(own, Path(folder), Path(folder), options)
    return max(models.values(), key=lambda model: model.num_reg_images(), default=None)


def _sightings(model: Any) -> int:
    """Count the features that a model's points explain."""
    return sum(point.track.length() for point in model.points3D.values())


def _scene(model: Any, others: Sequence[Any], views: int) -> MappedScene:
    """Return the scene of a model, with its path's expected error; the others explain at most as much."""
    poses = _poses(model, views)
    path = camera_centres(poses)
    numbers = np.array(sorted(model.points3D))

    def without(half: Bool) -> F64:
        return _poses(_adjusted_without(model, numbers[half].tolist()), views)

    expected = error_from_halves(poses, np.arange(len(numbers)), without)
    if expected is not None:
        extent = path_extent(poses)
        rivals = [other for other in others if _sightings(other) >= _RIVALS * _sightings(model)]
        apart = [squared_distance(camera_centres(_poses(rival, views)), path) ** 0.5 / extent for rival in rivals]
        expected = max([expected, *apart])
    points = np.array([point.xyz for point in model.points3D.values()]).reshape(-1, 3)
    return MappedScene(poses, points, float(model.compute_mean_reprojection_error()), expected)


def _poses(model: Any, views: int) -> F64:
    poses = rigid(np.eye(3), np.zeros((views, 3)))
    for image in model.images.values():
        poses[int(image.name), :3] = image.cam_from_world().matrix()
    return poses


def _adjusted_without(model: Any, points: Sequence[int]) -> Any:
    """Return a copy of a model, adjusted without some of its points."""
    rest = pycolmap.Reconstruction(model)
    for number in points:
        rest.delete_point3D(number)
    options, config = pycolmap.BundleAdjustmentOptions(_ADJUSTING), pycolmap.BundleAdjustmentConfig()
    for image in rest.reg_image_ids():
        config.add_image(image)
    pycolmap.create_default_bundle_adjuster(options, config, rest).solve()
    return rest
