"""Shots and damaged files for the tests of core."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.records import Shot, Truth


@pytest.fixture
def make_shot() -> Callable[..., Shot]:
    """A small shot that obeys Y = Σ w M X; keyword arguments replace its fields."""

    def make(n: int = 4, height: int = 12, width: int = 16, channels: int = 3, seed: int = 0, **fields: object) -> Shot:
        rng = np.random.default_rng(seed)
        masks = (rng.random((n, height, width)) < 0.5).astype(np.float32)
        views = np.rint(rng.random((n, height, width, channels)) * 255).astype(np.float32) / np.float32(255)
        measurement = np.einsum("nhw,nhwc->hwc", masks, views, dtype=np.float64).astype(np.float32)
        intrinsics = np.array([[20.0, 0, width / 2], [0, 21.0, height / 2], [0, 0, 1]])
        poses = np.tile(np.eye(4), (n, 1, 1))
        poses[:, 0, 3] = np.linspace(-1, 1, n)
        shot = Shot(
            measurement=measurement,
            masks=masks,
            weights=np.ones(n, np.float32),
            intrinsics=intrinsics,
            truth=Truth(views, poses),
            name="small",
            provenance={"seed": seed},
        )
        return replace(shot, **fields)  # type: ignore[arg-type]

    return make


@pytest.fixture
def mutations() -> Callable[[bytes, int, int], Iterator[bytes]]:
    """Damaged copies of a file: a few changed bytes, mostly in its head where the structure is; sometimes cut."""

    def damaged(data: bytes, count: int, seed: int) -> Iterator[bytes]:
        rng = np.random.default_rng(seed)
        for _ in range(count):
            copy = bytearray(data)
            for _ in range(int(rng.choice([1, 1, 2, 8]))):
                reach = min(len(copy), int(rng.choice([200, 5000, 10**9])))
                copy[int(rng.integers(reach))] = int(rng.integers(256))
            if rng.random() < 0.2:
                copy = copy[: int(rng.integers(len(copy)))]
            yield bytes(copy)

    return damaged
