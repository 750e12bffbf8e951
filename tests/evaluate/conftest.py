"""Made-up shots and results, so that what is written and drawn can be tested without any reconstruction."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.findings import Code, finding
from gs2ci.core.records import Shot, Truth
from gs2ci.core.run_figures import CurvePoint, EnsembleSection
from gs2ci.core.run_records import RunResult
from gs2ci.core.uncertainty import Uncertainty
from gs2ci.render.gaussians import Gaussians
from tests.evaluate.reports import a_geometry


def sureness(depth: np.ndarray) -> Uncertainty:
    """Standard errors that grow to the right, from 0.01 to 0.1 in views and from 1 to 10 % of depth."""
    ramp = np.broadcast_to(np.linspace(0.01, 0.1, depth.shape[2], dtype=np.float32), depth.shape)
    return Uncertainty(ramp.copy(), depth * ramp, np.full(len(depth), 0.004), np.full(len(depth), 0.002))


MakeRun = Callable[..., tuple[Shot, RunResult]]


def stage_path(count: int, step: float = 0.1, bend: float = 0.02) -> np.ndarray:
    """World-to-camera poses along x with a slight bend and a slight turn, [N, 4, 4]."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    phase = np.linspace(-1, 1, count) if count > 1 else np.zeros(1)
    angle = 0.02 * phase
    poses[:, 0, 0] = poses[:, 2, 2] = np.cos(angle)
    poses[:, 0, 2], poses[:, 2, 0] = np.sin(angle), -np.sin(angle)
    centers = np.stack([step * count * phase / 2, bend * phase**2, 0.5 * bend * phase**3], 1)
    poses[:, :3, 3] = -np.einsum("nij,nj->ni", poses[:, :3, :3], centers)
    return poses


def textured_views(count: int, height: int, width: int, channels: int) -> np.ndarray:
    """Smooth waves that slide from view to view, [N, H, W, C] float32 in [0, 1]."""
    y, x = np.mgrid[:height, :width].astype(np.float64)
    views = np.empty((count, height, width, channels), np.float32)
    for n in range(count):
        for c in range(channels):
            wave = np.sin(0.15 * (x + 2 * n) + c) * np.cos(0.11 * y - 0.5 * c) + 0.3 * np.sin(0.05 * x * y / height)
            views[n, :, :, c] = 0.5 + 0.35 * wave
    return np.clip(views, 0, 1)


@pytest.fixture(scope="session")
def scene() -> Gaussians:
    """Fifty Gaussians at random."""
    generator = torch.Generator().manual_seed(0)
    shapes = {
        "means": (50, 3),
        "log_scales": (50, 3),
        "quaternions": (50, 4),
        "opacity_logits": (50,),
        "colours": (50, 3),
    }
    return Gaussians(**{name: torch.randn(shape, generator=generator) for name, shape in shapes.items()})


@pytest.fixture(scope="session")
def make_run() -> MakeRun:
    """Make a shot and a plausible result of it: `make_run(count=8, size=(48, 64), channels=3, truth=True)`."""

    def make(
        count: int = 8, size: tuple[int, int] = (48, 64), channels: int = 3, *, truth: bool = True
    ) -> tuple[Shot, RunResult]:
        rng = np.random.default_rng(7)
        views, path = textured_views(count, *size, channels), stage_path(count)
        masks = (rng.random((count, *size)) < 0.25).astype(np.float32)
        masks[0, 0, 0] = 1
        measurement = np.einsum("nhw,nhwc->hwc", masks, views)
        shot = Shot(
            measurement=measurement.astype(np.float32),
            masks=masks,
            weights=np.ones(count, np.float32),
            truth=Truth(views, path) if truth else Truth(),
            name="waves",
        ).check()
        found = (views + 0.02 * rng.standard_normal(views.shape)).astype(np.float32)
        decode = (views + 0.07 * rng.standard_normal(views.shape)).astype(np.float32)
        poses = path.copy()
        poses[:, :3, 3] = 2.5 * (poses[:, :3, 3] + 0.002 * rng.standard_normal((count, 3)))
        depth = np.broadcast_to(np.linspace(2, 9, size[0], dtype=np.float32)[None, :, None], (count, *size)).copy()
        curve = [
            CurvePoint(9 + 0.08 * i, i, 0.1 / (1 + i / 50), 0.2 / (1 + i / 60), 31 - 9 / (1 + i / 80), 9000 + 4 * i)
            for i in range(0, 1001, 50)
        ]
        if not truth:
            curve = [replace(point, psnr_db=None) for point in curve]
        result = RunResult(
            views=found,
            scene_views=np.float32(0.98) * found,
            depth=depth,
            world_to_camera=poses,
            intrinsics=np.array([[size[1] * 1.1, 0, size[1] / 2], [0, size[1] * 1.1, size[0] / 2], [0, 0, 1]]),
            decode=decode,
            predicted_measurement=np.einsum("nhw,nhwc->hwc", masks, found).astype(np.float32),
            curve=curve,
            stopped=finding(Code.FIT_STALLED, best=900),
            seconds={"total": 89.0, "decode": 4.2, "geometry": 4.8, "fit": 80.0},
            gaussians=13000,
            notes=(finding(Code.FOCAL_ESTIMATED, focal_px=70.4, spread=0.1, view_angle_deg=49.0),),
            settings={"iterations": 1000, "preset": "standard"},
            seed=0,
            verdict="refined",
            heldout_rms={"refined": 0.021, "scene": 0.022, "decode": 0.058},
            geometry=a_geometry(tracks=812),
            ensemble=EnsembleSection(2, 2, 0.011),
            disagreement=np.full((count, *size), 0.011, np.float32),
            uncertainty=sureness(depth),
        )
        return shot, result

    return make
