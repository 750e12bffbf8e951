"""Photographs on planes coded along four adjacent paths: each path alone, and all together.

    python -m tests.benchmarks photograph_paths

Three arrangements of sample photographs (`tests/benchmarks/photographs.py`: seen by rays, nine a pixel, so that no
Gaussian model flatters), 72 × 96 px, eight views a path, random masks, a quarter open, 1 % noise, poses reported by a
stage without error. `GS2CI_ROOMS=0:3` takes some arrangements, `GS2CI_SEED` draws other masks and noise.

Printed as by `python -m tests.benchmarks exposures`.
"""

import os

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import pinhole
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.novel_views import NovelViews
from tests.benchmarks.exposures import HEADER, adjacent_rows
from tests.benchmarks.photographs import Card, cards, rail, render

SIZE = (72, 96)
PATHS, VIEWS = 4, 8
TRAVEL, STEP = 0.1, 0.27
"""Length of a path, and distance of neighbouring ones; the nearest photograph lies 1.5 away."""
OPEN_SHARE, NOISE = 0.25, 0.01


def run() -> None:
    """Print the table."""
    first, last = (int(part) for part in os.environ.get("GS2CI_ROOMS", "0:3").split(":"))
    seed = int(os.environ.get("GS2CI_SEED", "0"))
    print(HEADER)
    for which in range(first, last):
        shots, between = drawn(which, seed)
        print(adjacent_rows(f"cards {which}", shots, between), flush=True)


def drawn(which: int, seed: int) -> tuple[list[Shot], NovelViews]:
    """Expose four paths side by side; also return the views in the middle of the gaps between them."""
    scene, centres = cards(which), STEP * (np.arange(PATHS) - (PATHS - 1) / 2)
    along = TRAVEL * np.linspace(-0.5, 0.5, VIEWS)
    # One rail carries all paths: it bends and turns a little over its whole length.
    poses = rail((centres[:, None] + along).ravel()).reshape(PATHS, VIEWS, 4, 4)
    gaps = rail(np.concatenate([(centres[:-1] + centres[1:]) / 2, centres[[0, -1]]]))[:-2]
    shots = [_exposed(scene, path, [seed, which, number]) for number, path in enumerate(poses)]
    images = np.stack([render(scene, pose, _camera(), SIZE)[0] for pose in gaps])
    return shots, NovelViews(images, gaps)


def _camera() -> F64:
    return pinhole(1.1 * SIZE[1], SIZE)


def _exposed(scene: tuple[Card, ...], poses: F64, seed: list[int]) -> Shot:
    rng = np.random.default_rng(seed)
    images, depths = (
        np.stack(part) for part in zip(*(render(scene, pose, _camera(), SIZE) for pose in poses), strict=True)
    )
    masks = (rng.random((VIEWS, *SIZE)) < OPEN_SHARE).astype(np.float32)
    coded = (masks[..., None] * images).sum(axis=0) + rng.normal(0, NOISE, (*SIZE, 3))
    depths = np.where(np.isfinite(depths), depths, 0).astype(np.float32)
    return Shot(
        coded.astype(np.float32),
        masks,
        intrinsics=_camera(),
        truth=Truth(images, poses, depths),
        telemetry_world_to_camera=poses,
        name=f"path {seed[-1]}",
    ).check()
