"""A textured wall with a step in it, seen by cameras along a line: all that standard errors are asked of."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.uncertainty.information import ReadingsSeen
from gs2ci.reconstruct.uncertainty.views import ViewsMade

SIZE = (24, 32)
FOCAL_PX = 35.0


def path(count: int, way: tuple[float, float, float] = (0.2, 0.0, 0.0)) -> np.ndarray:
    """World-to-camera poses along a line, [N, 4, 4]."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    places = np.linspace(-0.5, 0.5, count) if count > 1 else np.zeros(1)
    poses[:, :3, 3] = -places[:, None] * way
    return poses


def textured(count: int, channels: int = 3) -> np.ndarray:
    """Views of even texture that moves by a pixel from view to view, [N, H, W, C]."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    shift = np.arange(count)[:, None, None]
    wave = 0.5 + 0.3 * np.sin(0.9 * (columns + shift)) * np.cos(0.7 * rows)
    return np.repeat(wave[..., None], channels, axis=3).astype(np.float32)


@pytest.fixture
def seen() -> ReadingsSeen:
    """Six views of a wall at depth 2 whose right half lies at 3."""
    count = 6
    height, width = SIZE
    rows, columns = np.mgrid[:height, :width] + 0.5
    rays = np.stack([columns - width / 2, rows - height / 2], axis=-1) / FOCAL_PX
    depth = np.where(columns < width / 2, 2.0, 3.0).astype(np.float32)
    rng = np.random.default_rng(1)
    return ReadingsSeen(
        views=textured(count),
        depth=np.repeat(depth[None], count, axis=0),
        spread=np.zeros((count, *SIZE), np.float32),
        rays=rays.astype(np.float32),
        world_to_camera=path(count),
        focal_px=np.array([FOCAL_PX, FOCAL_PX]),
        transmissions=(rng.random((count, *SIZE)) < 0.4).astype(np.float32),
        noise=np.full((*SIZE, 3), 1e-4, np.float32),
    )


Measured = Callable[..., tuple[Holdout, ViewsMade, np.ndarray]]


@pytest.fixture
def measured() -> Measured:
    """Make a measurement, views that err by so much, and the true views."""

    def make(
        error: float = 0.03, *, count: int = 6, share: float = 0.1, noise: float = 0.0, seed: int = 0
    ) -> tuple[Holdout, ViewsMade, np.ndarray]:
        rng = np.random.default_rng(seed)
        true = textured(count)
        masks = (rng.random((count, *SIZE)) < 0.4).astype(np.float32)
        coded = np.einsum("nhw,nhwc->hwc", masks, true) + noise * rng.standard_normal((*SIZE, 3))
        shot = Shot(coded.astype(np.float32), masks, np.ones(count, np.float32)).check()
        # In places, unlike noise, which is everywhere.
        places = (rng.random(true.shape[1:3]) < 0.2)[None, ..., None] / 0.2**0.5
        found = (true + error * places * rng.standard_normal(true.shape)).astype(np.float32)
        return Holdout.of(shot, share, 0), ViewsMade(found, found, None), true

    return make


@pytest.fixture
def still(seen) -> ReadingsSeen:
    """The same from cameras that do not move."""
    return replace(seen, world_to_camera=path(len(seen.depth), (0, 0, 0)))
