"""Photographs 15° apart in random order: is a path found, and how accurate is it?

    python -m tests.benchmarks wide_motion            # geometry and whole reconstructions
    WIDE_PATHS_ONLY=1 python -m tests.benchmarks wide_motion

Eight sets of eight views, 192 × 256 px: random rooms of tilted rectangles and boxes, and scenes of the simulator's
library, seen from places scattered about the middle one on a sphere around the scene's middle, up to 12° to either side
and 6° up and down, cameras turned to the scene but for a few degrees; in random order. Coded by random masks, a quarter
open, with noise of 0.5 % of full scale. For each: the largest angle between consecutive views; which source gave the
path; its error (nATE) and that of the rotations, by tracks alone and as `auto` takes it; the PSNR of the decode and of
the reconstruction.
"""

import os
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.prior import Request
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from gs2ci.render.backend import load_backend
from gs2ci_sims.masks import random_masks
from gs2ci_sims.scene import Scene
from gs2ci_sims.scenes.files import load_scene
from gs2ci_sims.scenes.planes import planes
from tests.processes import side_by_side

SIZE: Final = (192, 256)
VIEWS: Final = 8
ACROSS_DEG, UP_DEG, TURN_DEG = 12.0, 6.0, 2.0
NOISE: Final = 0.005
LIBRARY: Final = ("boxes", "motorcycle", "thicket")
SETS: Final = 8
# Whether the environment asks for the first geometry only: its name there.
PATHS_ONLY: Final = "WIDE_PATHS_ONLY"


@dataclass(frozen=True)
class WideSet:
    """Views in no order.

    Args:
        shot: Their measurement.
        apart_deg: The largest angle between consecutive cameras.
    """

    shot: Shot
    apart_deg: float


def run() -> None:
    """Reconstruct every set."""
    print(f"{'':18} {'apart':>6}   {'tracks alone':28} auto")
    for line in side_by_side(judge, range(SETS)):
        print(line, flush=True)


def judge(number: int) -> str:
    """Find the path of one set, and unless told otherwise reconstruct it; return its line of the table."""
    drawn, settings = draw(number), Settings(fits=1, motion="off")
    request = first_request(drawn.shot, settings)
    found = [_said(load_geometry_prior(name)(request, Silent()), drawn.shot) for name in ("tracks", "auto")]
    line = f"{drawn.shot.name:18} {drawn.apart_deg:5.1f}°   {found[0]:28} {found[1]:28}"
    if os.environ.get(PATHS_ONLY):
        return line
    result, truth = reconstruct(drawn.shot, settings).result, drawn.shot.truth.views
    assert truth is not None
    decode, views = (float(np.mean(psnr_per_view(one, truth))) for one in (request.views, result.views))
    return f"{line} decode {decode:.2f} dB, reconstruction {views:.2f} dB ({result.verdict})"


def first_request(shot: Shot, settings: Settings) -> Request:
    """Ask for a path in views decoded by GAP-TV, as a reconstruction does first."""
    seen = Holdout.of(shot, settings.fit.hold_out.share, settings.seed).seen
    return Request.of(seen, gap_tv(seen, settings.decode, Silent()), settings.geometry, None)


def _said(geometry: Geometry, shot: Shot) -> str:
    assert shot.truth.world_to_camera is not None
    if geometry.verdict != "full":
        return f"{geometry.source}: {geometry.verdict}"
    found = trajectory_errors(geometry.world_to_camera, shot.truth.world_to_camera)
    return f"{geometry.source}: {found.nate:.4f}, {found.rotation_deg:.2f}°"


def draw(number: int, seed: int = 0) -> WideSet:
    """Draw a set: library scenes first, then random rooms."""
    rng = np.random.default_rng([seed, number])
    scene = load_scene(LIBRARY[number], size=SIZE).scene if number < len(LIBRARY) else _room(rng)
    poses = scattered(rng, _middle_depth(scene)) @ scene.world_to_camera
    views, _ = load_backend("cpu").views(
        scene.gaussians, torch.from_numpy(poses).float(), torch.from_numpy(scene.intrinsics).float(), scene.size
    )
    truth, masks = views.clamp(0, 1).numpy(), random_masks(VIEWS, scene.size, 0.25, rng)
    coded = (masks[..., None] * truth).sum(axis=0) + NOISE * rng.standard_normal(truth.shape[1:])
    shot = Shot(
        measurement=coded.astype(np.float32),
        masks=masks,
        intrinsics=scene.intrinsics,
        truth=Truth(truth, poses),
        name=LIBRARY[number] if number < len(LIBRARY) else f"room {number}",
    ).check()
    turns = Rotation.from_matrix(poses[1:, :3, :3] @ poses[:-1, :3, :3].transpose(0, 2, 1))
    return WideSet(shot, float(np.degrees(turns.magnitude()).max()))


def _room(rng: np.random.Generator) -> Scene:
    depths = tuple(np.sort(rng.uniform(2.5, 4.7, 5)).tolist())
    return planes(rng, SIZE, depths=depths, backdrop=5.0, boxes=2, field_of_view_deg=50)


def _middle_depth(scene: Scene) -> float:
    near, far = scene.depth_range()
    return 2 / (1 / near + 1 / far)


def scattered(rng: np.random.Generator, distance: float) -> F64:
    """Draw poses, [N, 4, 4], about a point ahead at a distance; the middle one of the list looks straight at it."""
    poses = np.tile(np.eye(4), (VIEWS, 1, 1))
    pivot = np.array([0.0, 0.0, distance])
    for i in range(VIEWS):
        if i == VIEWS // 2:
            continue
        about = Rotation.from_euler("yx", rng.uniform(-1, 1, 2) * (ACROSS_DEG, UP_DEG), degrees=True)
        looks = Rotation.from_rotvec(rng.uniform(-1, 1, 3) * TURN_DEG, degrees=True)
        turn = (looks * about).as_matrix()
        # The pivot stays ahead at its distance, but for where the camera looks.
        poses[i, :3, :3], poses[i, :3, 3] = turn, looks.apply(pivot) - turn @ pivot
    return poses
