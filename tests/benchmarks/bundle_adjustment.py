"""Our small-motion bundle adjustment, Ceres (through pycolmap), and Ceres started from our result: path error, time.

The first two get the same tracks, the same camera matrix, the same start (a still camera and a nearly flat scene),
the same Huber width and the same second pass without the tracks that the first does not explain. Ours also tries the
depth-reversed scene, four adjustments in all; Ceres cannot: its points may pass beyond infinity, and then the reversed
scene may fit best. The third is the product's method (`initialise`).

The tracks are projected random points with outliers and noise, in the other views only (a tracker takes the corner in
the reference view as exact, because it is the template) or in all; if the shared measurements are available
(`GS2CI_SHARED_DATA`), also the tracks of their decoded views. The adapter that starts without an initial path is part
of this file, because it was not better and the product does not use it.
"""

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pycolmap
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64
from gs2ci.core.records import Shot
from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.geometry.path.bundle import adjust_bundle
from gs2ci.reconstruct.geometry.path.motion import MotionSettings, Sightings, estimate_motion, start_motion
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks, find_corners, find_tracks

SHARED = ("fern_smooth", "fern_smooth_cr16", "fern_smooth_r50", "fern_photos_wide")
ROUNDS = 3

Case = tuple[str, Tracks, F64, F64]  # name, tracks, intrinsics, true world_to_camera
Way = Callable[[Tracks, F64], F64]  # tracks, intrinsics -> world_to_camera


def run() -> None:
    ways = {"ours": _ours, "Ceres": _ceres, "both": _both}
    table = Table("case", "tracks", *(f"{name} {what}" for name in ways for what in ("nATE", "°", "ms")))
    for name, tracks, intrinsics, truth in _cases():
        cells = []
        for way in ways.values():
            poses, seconds = _fastest(way, tracks, intrinsics)
            errors = trajectory_errors(poses, truth)
            cells += [f"{errors.nate:.4f}", f"{errors.rotation_deg:.3f}", f"{1e3 * seconds:.0f}"]
        table.add_row(name, str(len(tracks)), *cells)
    Console().print(table)


def _fastest(way: Way, tracks: Tracks, intrinsics: F64) -> tuple[F64, float]:
    best = np.inf
    for _ in range(ROUNDS):
        started = time.perf_counter()
        poses = way(tracks, intrinsics)
        best = min(best, time.perf_counter() - started)
    return poses, best


def _ours(tracks: Tracks, intrinsics: F64) -> F64:
    return estimate_motion(tracks, intrinsics)[0].world_to_camera


def _both(tracks: Tracks, intrinsics: F64) -> F64:
    motion, kept = estimate_motion(tracks, intrinsics)
    huber_px = MotionSettings().huber_px
    return adjust_bundle(kept, motion.world_to_camera, intrinsics, huber_px, refine_focal=False).world_to_camera


def _ceres(tracks: Tracks, intrinsics: F64) -> F64:
    settings = MotionSettings()
    _, residuals_px = _adjust_by_ceres(tracks, intrinsics, settings)
    explained = np.nanmax(residuals_px, axis=1, initial=0) < settings.outlier_px
    return _adjust_by_ceres(tracks.keep(explained) if explained.any() else tracks, intrinsics, settings)[0]


def _adjust_by_ceres(tracks: Tracks, intrinsics: F64, settings: MotionSettings) -> tuple[F64, F64]:
    """Return poses, [N, 4, 4], and residuals, [P, N] px with NaN where not seen."""
    scene = _reconstruction(tracks, intrinsics)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = options.refine_principal_point = options.refine_extra_params = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.HUBER
    options.ceres.loss_function_scale = settings.huber_px
    options.ceres.solver_options.max_num_iterations = settings.iterations
    options.ceres.solver_options.function_tolerance = settings.tolerance
    options.ceres.solver_options.num_threads = 1
    options.print_summary = False
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in scene.images:
        config.add_image(image_id)
    config.set_constant_cam_intrinsics(1)
    config.set_constant_rig_from_world_pose(scene.images[tracks.reference + 1].frame_id)
    pycolmap.create_default_bundle_adjuster(options, config, scene).solve()

    poses = np.tile(np.eye(4), (tracks.positions.shape[1], 1, 1))
    residuals = np.full(tracks.seen.shape, np.nan)
    points = np.array([scene.points3D[i + 1].xyz for i in range(len(tracks))])
    for i in range(len(poses)):
        poses[i, :3] = scene.images[i + 1].cam_from_world().matrix()
        seen = tracks.seen[:, i]
        pixels = (points[seen] @ poses[i, :3, :3].T + poses[i, :3, 3]) @ intrinsics.T
        residuals[seen, i] = np.linalg.norm(pixels[:, :2] / pixels[:, 2:] - tracks.positions[seen, i], axis=1)
    return poses, residuals


def _reconstruction(tracks: Tracks, intrinsics: F64) -> pycolmap.Reconstruction:
    """Write the tracks as COLMAP's model: camera 1, images 1 to N, points 1 to P on their reference rays."""
    sightings = Sightings.of(tracks, intrinsics)
    points = sightings.rays / start_motion(sightings).inverse_depth[:, None]
    scene = pycolmap.Reconstruction()
    parameters = [intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2]]
    size = (2 * intrinsics[:2, 2]).astype(int)
    scene.add_camera_with_trivial_rig(
        pycolmap.Camera(camera_id=1, model="PINHOLE", width=size[0], height=size[1], params=parameters)
    )
    seen_by: list[list[pycolmap.TrackElement]] = [[] for _ in points]
    for i in range(tracks.positions.shape[1]):
        visible = np.flatnonzero(tracks.seen[:, i])
        image = pycolmap.Image(name=f"{i}", keypoints=tracks.positions[visible, i], camera_id=1, image_id=i + 1)
        scene.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
        for k, p in enumerate(visible):
            seen_by[p].append(pycolmap.TrackElement(i + 1, k))
    for p, xyz in enumerate(points):
        scene.add_point3D_with_id(p + 1, pycolmap.Point3D(xyz=xyz, track=pycolmap.Track(seen_by[p])))
    return scene


def _cases() -> Iterator[Case]:
    for everywhere in (False, True):
        for noise_px, outliers in ((0.1, 0.0), (0.5, 0.2), (1.0, 0.3)):
            for seed in range(3):
                yield _simulated(noise_px, outliers, everywhere, seed)
    folder = Path(os.environ.get("GS2CI_SHARED_DATA", Path(__file__).parents[3] / "shared" / "data"))
    for name in SHARED:
        if (folder / f"{name}.npz").is_file():
            yield _decoded(folder / f"{name}.npz")


def _simulated(noise_px: float, outliers: float, everywhere: bool, seed: int) -> Case:
    """Project random points into a bent, hand-held path of eight views; spoil some sightings."""
    rng = np.random.default_rng(seed)
    views, points, reference = 8, 600, 4
    intrinsics = np.array([[300.0, 0, 180], [0, 300, 135], [0, 0, 1]])
    along = np.linspace(-1, 1, views)[:, None] - np.linspace(-1, 1, views)[reference]
    centres = 0.04 * (rng.normal(size=3) * along + 0.5 * rng.normal(size=3) * along**2)
    turns = Rotation.from_rotvec(0.01 * (rng.normal(size=3) * along + 0.5 * rng.normal(size=3) * along**2))
    poses = np.tile(np.eye(4), (views, 1, 1))
    poses[:, :3, :3] = turns.as_matrix()
    poses[:, :3, 3] = -np.einsum("nij,nj->ni", poses[:, :3, :3], centres)
    pixels = rng.uniform((0, 0), (360, 270), (points, 2))
    rays = np.concatenate([pixels, np.ones((points, 1))], axis=1) @ np.linalg.inv(intrinsics).T
    world = rays / rng.uniform(0.4, 1.8, (points, 1))
    camera = (world @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]) @ intrinsics.T
    positions = (camera[..., :2] / camera[..., 2:]).transpose(1, 0, 2)
    noise = noise_px * rng.normal(size=positions.shape)
    spoilt = rng.random((points, views)) < outliers / views
    noise[spoilt] += 15 * rng.normal(size=(int(spoilt.sum()), 2))
    if not everywhere:
        noise[:, reference] = 0
    positions += noise
    name = f"{noise_px} px{' in all views' if everywhere else ''}, {outliers:.0%} outliers, seed {seed}"
    return name, Tracks(positions, reference), intrinsics, poses


def _decoded(path: Path) -> Case:
    with np.load(path) as data:
        masks = data["masks"].astype(np.float32)
        shot = Shot(data["meas"].astype(np.float32), masks, np.ones(len(masks), np.float32))
        intrinsics, truth = data["K"].astype(np.float64), data["world_to_camera"].astype(np.float64)
    views, reference = gap_tv(shot), len(masks) // 2
    tracks = find_tracks(views, reference, find_corners(views, reference))
    return path.stem, tracks.seen_by_at_least(int(np.ceil(0.6 * len(masks)))), intrinsics, truth
