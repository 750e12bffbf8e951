"""Exposures of one scene without telemetry, in random order: are they tied, how accurately, and what is left out?

    python -m tests.benchmarks ties

Ten draws at each of two noises (0.5 and 5 % of full scale), 96 × 128 px: rooms of five to eight tilted rectangles and
one to three boxes, each seen by eight exposures of eight views, 5 to 9 px of parallax each. Half of the draws lie
around the scene's middle, up to 12° to either side and 6° up and down; half in a row, a tenth of the frame from one to
the next at the scene's middle; cameras turned by up to 2°, paths in random directions, in random order. A ninth
exposure, drawn of another room, is among them. Masks are random, a quarter open; views are decoded by GAP-TV, paths and
depths found in them as a reconstruction does first.

For each draw: how many of the eight are tied, whether the ninth is left out by name, and whether all numbers of the
others are the same without it; the largest and the median misplacement: how far apart, in px, an exposure's nearest
neighbour sees what both see, along the similarities that were found and along the true ones; the error of all 64 poses
(nATE, degrees), and what it would be if the depths of single exposures were taken as they are; processor seconds.
`GS2CI_SEED` draws other rooms; `GS2CI_DRAWS=0:3` takes some of the draws of each noise.
"""

import os
import time
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import camera_centres, pinhole
from gs2ci.core.lens import seen_by
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.trajectory import align, trajectory_errors
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.exposures.tie import Tied, Ties, Untied, tie
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.geometry.depth.view_depths import project
from gs2ci.reconstruct.geometry.prior import Request, find_geometry
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.backend import load_backend
from gs2ci_sims.masks import random_masks
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.planes import planes
from tests.processes import side_by_side

SIZE: Final = (96, 128)
VIEWS: Final = 8
EXPOSURES: Final = 8
NOISES: Final = (0.005, 0.05)
DRAWS: Final = 10
SEED: Final = int(os.environ.get("GS2CI_SEED", "0"))
# The room fills a wider field than a camera sees, so that cameras can move.
SCENE_DEG, CAMERA_DEG = 70.0, 42.0
NEAREST, BACKDROP, DISTANCE = 2.4, 5.0, 3.5
ACROSS_DEG, UP_DEG, TURN_DEG = 12.0, 6.0, 2.0
LAYOUTS: Final = ("around", "row")
STEP_SHARE: Final = 0.1
OPEN_SHARE: Final = 0.25
# Misplaced by no more than this, an exposure counts as rightly tied.
RIGHT_PX: Final = 5.0


@dataclass(frozen=True)
class Row:
    """What became of a draw."""

    noise: float
    tied: int
    right: int
    left_out: bool
    same: bool
    line: str


def run() -> None:
    """Tie every draw, and count."""
    first, last = (int(part) for part in os.environ.get("GS2CI_DRAWS", f"0:{DRAWS}").split(":"))
    tasks = [(noise, number) for noise in NOISES for number in range(first, last)]
    rows = []
    print(f"{'':18} tied right  ninth   others    misplaced px        path        as observed   seconds")
    for row in side_by_side(judge, tasks):
        rows.append(row)
        print(row.line, flush=True)
    for noise in NOISES:
        own = [row for row in rows if row.noise == noise]
        print(
            f"noise {100 * noise:g} %: all tied in {sum(row.tied == EXPOSURES for row in own)} of {len(own)} draws, "
            f"all rightly in {sum(row.right == EXPOSURES for row in own)}; {sum(row.tied for row in own)} of "
            f"{EXPOSURES * len(own)} exposures tied, {sum(row.right for row in own)} rightly; the ninth left out by "
            f"name in {sum(row.left_out for row in own)}, the others the same without it in "
            f"{sum(row.same for row in own)}"
        )


def judge(task: tuple[float, int]) -> Row:
    """Tie the exposures of one draw with and without one of another room."""
    noise, number = task
    scene, shots = drawn(number, noise)
    # The ninth is of the next draw, at a random place among the others.
    other = drawn(number + 1, noise)[1][number % EXPOSURES]
    exposures = [observed(shot) for shot in shots]
    at = int(np.random.default_rng(number).integers(0, EXPOSURES + 1))
    began = time.process_time()
    with_it = tie([*exposures[:at], observed(other), *exposures[at:]])
    seconds = time.process_time() - began
    left_out = with_it.left_out.get(at)
    ties = Ties(tuple(one for k, one in enumerate(with_it.all) if k != at), with_it.distance_px)
    same = _same(ties, tie(exposures))
    tied = ties.tied
    off = misplaced_px(shots, tied, scene)
    right = sum(value <= RIGHT_PX for value in off)
    path = _path(shots, {k: one.common_from_own.poses(one.geometry.world_to_camera) for k, one in tied.items()})
    alone = {k: one.common_from_own.poses(exposures[k].geometry.world_to_camera) for k, one in tied.items()}
    line = (
        f"{100 * noise:3g} % {LAYOUTS[number % 2]:>6} {number:2}   {len(tied)}    {right}     "
        f"{'out' if left_out else 'in':5}  {'same' if same else 'moved':8} "
        f"{max(off, default=np.nan):5.1f} {np.median(off) if off else np.nan:5.1f}   {path}   {_path(shots, alone)}   "
        f"{seconds:5.1f}"
    )
    return Row(noise, len(tied), right, left_out is not None and left_out.name == other.name, same, line)


def _same(one: Ties, other: Ties) -> bool:
    """Tell whether both tie the same exposures, with the same numbers."""
    return list(one.tied) == list(other.tied) and all(
        np.array_equal(one.tied[k].common_from_own.translation, other.tied[k].common_from_own.translation)
        and np.array_equal(one.tied[k].geometry.world_to_camera, other.tied[k].geometry.world_to_camera)
        for k in one.tied
    )


def _path(shots: list[Shot], poses: dict[int, F64]) -> str:
    if len(poses) < 2:
        return "–"
    true = np.concatenate([_true(shots[k]) for k in poses])
    found = trajectory_errors(np.concatenate(list(poses.values())), true)
    return f"{found.nate:.4f} {found.rotation_deg:4.1f}°"


def _true(shot: Shot) -> F64:
    assert shot.truth.world_to_camera is not None
    return shot.truth.world_to_camera


def misplaced_px(shots: list[Shot], tied: dict[int, Tied], scene: Scene) -> list[float]:
    """Return for each tied exposure how far off its nearest neighbour sees what both see, in the median, px."""
    if len(tied) < 2:
        return []
    middles = {k: _true(shots[k])[VIEWS // 2] for k in tied}
    found = {k: one.common_from_own.poses(one.geometry.world_to_camera)[VIEWS // 2] for k, one in tied.items()}
    scale = align(np.stack(list(found.values())), np.stack(list(middles.values()))).scale
    points, matrix = scene.gaussians.means.double().numpy(), shots[0].intrinsics
    assert matrix is not None
    centres = {k: camera_centres(pose[None])[0] for k, pose in middles.items()}
    off = []
    for k in tied:
        near = min(
            (other for other in tied if other != k), key=lambda other: np.linalg.norm(centres[other] - centres[k])
        )
        between = found[near] @ np.linalg.inv(found[k])
        between[:3, 3] *= scale
        own, there = (seen_by(points, middles[n], matrix, SIZE)[0] for n in (k, near))
        seen = points[own & there]
        pixels, _ = project(seen, middles[near], matrix)
        moved, _ = project(seen, between @ middles[k], matrix)
        off.append(float(np.median(np.linalg.norm(pixels - moved, axis=1))))
    return off


def observed(shot: Shot) -> Untied:
    """Decode a measurement by GAP-TV, and find its path and depth."""
    settings = Settings()
    held = Holdout.of(shot.check(), settings.fit.hold_out.share, settings.seed).seen
    views = gap_tv(held, settings.decode, Silent())
    request = Request.of(held, views, settings.geometry, None)
    return Untied(shot.name, views, find_geometry(load_geometry_prior("auto"), request, Silent()))


def drawn(number: int, noise: float) -> tuple[Scene, list[Shot]]:
    """Draw a room, and its exposures in random order."""
    rng = np.random.default_rng([SEED, number, round(1000 * noise)])
    depths = tuple(np.sort(rng.uniform(NEAREST, 4.6, rng.integers(5, 9))).tolist())
    scene = planes(
        rng, SIZE, depths=depths, backdrop=BACKDROP, boxes=int(rng.integers(1, 4)), field_of_view_deg=SCENE_DEG
    )
    intrinsics = pinhole(SIZE[1] / 2 / np.tan(np.radians(CAMERA_DEG / 2)), SIZE)
    layout = LAYOUTS[number % 2]
    taken: list[Shot] = []
    for middle in rng.permutation(_middles(rng, layout, float(intrinsics[0, 0]))):
        poses = _path_about(rng, middle, float(intrinsics[0, 0]))
        views, _ = load_backend("cpu").views(
            scene.gaussians, torch.from_numpy(poses).float(), torch.from_numpy(intrinsics).float(), SIZE
        )
        truth, masks = views.clamp(0, 1).numpy(), random_masks(VIEWS, SIZE, OPEN_SHARE, rng)
        coded = (masks[..., None] * truth).sum(axis=0) + noise * rng.standard_normal(truth.shape[1:])
        name = f"{layout} {number}, {len(taken)}"
        taken.append(Shot(coded.astype(np.float32), masks, intrinsics=intrinsics, truth=Truth(truth, poses), name=name))
    return scene, taken


def _middles(rng: np.random.Generator, layout: str, focal_px: float) -> F64:
    """Draw the pose of the middle of each path, [E, 4, 4]."""
    poses = np.tile(np.eye(4), (EXPOSURES, 1, 1))
    pivot, frame = np.array([0.0, 0.0, DISTANCE]), SIZE[1] / focal_px * DISTANCE
    for k, pose in enumerate(poses):
        looks = Rotation.from_rotvec(rng.uniform(-1, 1, 3) * np.radians(TURN_DEG))
        if layout == "around":
            about = Rotation.from_euler("yx", rng.uniform(-1, 1, 2) * (ACROSS_DEG, UP_DEG), degrees=True)
            turn = (looks * about).as_matrix()
            pose[:3, :3], pose[:3, 3] = turn, looks.apply(pivot) - turn @ pivot
        else:
            centre = np.array([(k - (EXPOSURES - 1) / 2) * STEP_SHARE * frame, *(rng.uniform(-0.1, 0.1, 2) * frame)])
            pose[:3, :3], pose[:3, 3] = looks.as_matrix(), -looks.apply(centre)
    return poses


def _path_about(rng: np.random.Generator, middle: F64, focal_px: float) -> F64:
    """Move a camera along a line about a pose, with a little wobble, [N, 4, 4]."""
    length = float(rng.uniform(5, 9)) / (focal_px * (1 / NEAREST - 1 / BACKDROP))
    angle = rng.uniform(0, 2 * np.pi)
    direction = np.array([np.cos(angle), np.sin(angle), rng.uniform(-0.3, 0.3)])
    along = (np.arange(VIEWS) - VIEWS // 2)[:, None] / (VIEWS - 1) * length * direction
    moves = np.tile(np.eye(4), (VIEWS, 1, 1))
    moves[:, :3, :3] = Rotation.from_rotvec(np.radians(0.03) * rng.standard_normal((VIEWS, 3))).as_matrix()
    moves[:, :3, 3] = -np.einsum("nij,nj->ni", moves[:, :3, :3], along)
    return moves @ middle
