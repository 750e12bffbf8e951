"""Measurements of random form: whatever their size, masks, path, sensor and damage, a finite result or a typed error.

    python -m tests.stability --random 100              a hundred of them by preset `draft`, 60 iterations
    python -m tests.stability --random 100 --from 500   others

The catalogue (`cases.py`) asks for what somebody thought of. Here all that makes a measurement is drawn: photographs on
planes, cast by rays, in pictures of 9 to 130 px a side, of 1 to 24 views, behind ten families of masks, along eight
kinds of path, in colour, grey or behind a mosaic, noisy, clipped, damaged or in another unit, with and without camera
matrix, lens and stage. Numpy's warnings (overflow, invalid values) are errors. Nothing is said about accuracy: many of
these measurements determine nothing.
"""

import tempfile
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

import gs2ci
from gs2ci.core.arrays import F32, F64
from gs2ci.core.cameras import pinhole
from gs2ci.core.errors import Gs2ciError
from gs2ci.core.progress import Silent
from gs2ci.core.records import CFA_PATTERNS, Shot, Truth
from gs2ci.reconstruct.measurement.coding import cfa_channels
from tests.benchmarks.photographs import cards, render

Draw = np.random.Generator
ITERATIONS: Final = 60


def _complementary(rng: Draw, views: int, size: tuple[int, int]) -> F32:
    halves = rng.random((-(-views // 2), *size)) < 0.5
    return np.stack([mask for half in halves for mask in (half, ~half)])[:views].astype(np.float32)


def _blocks(rng: Draw, views: int, size: tuple[int, int]) -> F32:
    side = int(rng.choice([2, 4, 8]))
    coarse = rng.random((views, -(-size[0] // side), -(-size[1] // side))) < 0.5
    return np.kron(coarse, np.ones((1, side, side)))[:, : size[0], : size[1]].astype(np.float32)


def _moved(rng: Draw, views: int, size: tuple[int, int]) -> F32:
    """One pattern that moves by a pixel from view to view, as a mask on a translation stage does."""
    down, right = (1, 0) if rng.random() < 0.5 else (0, 1)
    pattern = rng.random((size[0] + views, size[1] + views)) < 0.5
    shown = [pattern[k * down :, k * right :][: size[0], : size[1]] for k in range(views)]
    return np.stack(shown).astype(np.float32)


def _in_a_circle(rng: Draw, views: int, size: tuple[int, int]) -> F32:
    rows, columns = np.mgrid[: size[0], : size[1]]
    seen = np.hypot(rows - size[0] / 2, columns - size[1] / 2) < min(size) / 2
    return ((rng.random((views, *size)) < 0.4) & seen).astype(np.float32)


def _random(rng: Draw, views: int, size: tuple[int, int]) -> F32:
    return (rng.random((views, *size)) < rng.choice([0.1, 0.25, 0.5, 0.75, 0.9])).astype(np.float32)


MASKS: Final[dict[str, Callable[[Draw, int, tuple[int, int]], F32]]] = {
    "random": _random,
    "moved": _moved,
    "one open": lambda rng, n, size: (rng.integers(0, n, size) == np.arange(n)[:, None, None]).astype(np.float32),
    "complementary": _complementary,
    "grey": lambda rng, n, size: rng.random((n, *size)).astype(np.float32),
    "leaking": lambda rng, n, size: (0.05 + 0.95 * (rng.random((n, *size)) < 0.5)).astype(np.float32),
    "blocks": _blocks,
    "whole rows": lambda rng, n, size: (rng.random((n, size[0], 1)) < 0.4).repeat(size[1], axis=2).astype(np.float32),
    "all the same": lambda rng, n, size: (rng.random((1, *size)) < 0.5).repeat(n, axis=0).astype(np.float32),
    "in a circle": _in_a_circle,
}

WAYS: Final[dict[str, tuple[float, float, float]]] = {
    "aside": (1, 0, 0),
    "up": (0, 1, 0),
    "ahead": (0, 0, 1),
    "far aside": (3, 0, 0),
    "in an arc": (1, 0.2, 0),
    "to and fro": (1, 1, 0),
    "turning": (0, 0, 0),
    "at rest": (0, 0, 0),
}
TURNING: Final = ("in an arc", "turning")

DAMAGES: Final = ("none", "none", "none", "clipped", "hot", "dead row", "unit", "black level", "below zero")


@dataclass(frozen=True)
class Form:
    """What a drawn measurement is; everything else follows from the seed.

    Args:
        seed: Of all draws.
        size: Height and width, px.
        views: N.
        masks: A key of `MASKS`.
        way: A key of `WAYS`.
        sensor: "rgb", "mono" or the pattern of a mosaic.
        damage: One of `DAMAGES`.
        noise: Standard deviation, full scales of one view.
    """

    seed: int
    size: tuple[int, int]
    views: int
    masks: str
    way: str
    sensor: str
    damage: str
    noise: float

    @classmethod
    def draw(cls, seed: int) -> "Form":
        """Draw a form; small pictures are as likely as large ones."""
        rng = np.random.default_rng([seed, 0])
        height, width = np.exp(rng.uniform(np.log(9), np.log(130), 2)).astype(int).tolist()
        return cls(
            seed=seed,
            size=(height, width),
            views=int(rng.choice([1, 2, 3, 4, 6, 8, 8, 8, 12, 16, 24])),
            masks=str(rng.choice(list(MASKS))),
            way=str(rng.choice(list(WAYS))),
            sensor=str(rng.choice(["rgb", "mono", str(rng.choice(CFA_PATTERNS))])),
            damage=str(rng.choice(DAMAGES)),
            noise=float(rng.choice([0, 0.01, 0.05, 0.2])),
        )

    def shot(self) -> Shot:
        """Make the measurement.

        Raises:
            Gs2ciError: Its parts do not fit together.
        """
        rng = np.random.default_rng([self.seed, 1])
        focal_px = float(rng.choice([0.4, 1.1, 1.1, 3, 10])) * max(self.size)
        intrinsics = pinhole(focal_px, self.size)
        if rng.random() < 0.3:
            intrinsics[:2, 2] += rng.normal(0, 0.2, 2) * self.size[::-1]
        travel = float(rng.choice([0.01, 0.05, 0.12, 0.3])) * 1.1 * max(self.size) / focal_px
        poses = self._poses(travel, rng)
        scene = cards(int(rng.integers(0, 3)), blur=float(rng.choice([0, 0, 0.05])))
        views = np.stack([render(scene, pose, intrinsics, self.size)[0] for pose in poses])
        if self.sensor == "mono":
            views = views.mean(axis=3, keepdims=True)
        masks = MASKS[self.masks](rng, self.views, self.size)
        flickers = rng.random() < 0.2
        weights = rng.uniform(0.3, 1.7, self.views) if flickers else np.ones(self.views)
        light = np.einsum("n,nhw,nhwc->hwc", weights, masks, views.astype(np.float64))
        if self.sensor in CFA_PATTERNS:
            light = np.take_along_axis(light, cfa_channels(self.sensor, self.size).numpy()[..., None], axis=2)
        light += rng.normal(0, self.noise, light.shape)
        light, saturated = self._damaged(light, rng)
        known = rng.random() < 0.6
        staged = poses.copy() if rng.random() < 0.2 else None
        if staged is not None:
            staged[:, :3, 3] += rng.normal(0, 0.02 * travel, (self.views, 3))
        bent = known and rng.random() < 0.2
        return Shot(
            light.astype(np.float32),
            masks,
            weights.astype(np.float32),
            cfa=self.sensor if self.sensor in CFA_PATTERNS else None,  # type: ignore[arg-type]
            intrinsics=intrinsics if known else None,
            distortion=np.array([rng.uniform(-0.3, 0.2), rng.uniform(-0.05, 0.05), 0, 0, 0]) if bent else None,
            truth=Truth(views, poses),
            telemetry_world_to_camera=staged,
            saturated=saturated,
            name=f"form {self.seed}",
        ).check()

    def _poses(self, travel: float, rng: Draw) -> F64:
        poses = np.tile(np.eye(4), (self.views, 1, 1))
        for pose, place in zip(poses, np.linspace(-0.5, 0.5, self.views), strict=True):
            centre = travel * place * np.array(WAYS[self.way])
            if self.way == "to and fro":
                centre = travel / 2 * rng.normal(size=3)
            if self.way in TURNING:
                pose[:3, :3] = Rotation.from_rotvec(np.array([0, 1, 0.1]) * place * travel / 2).as_matrix()
            pose[:3, 3] = -pose[:3, :3] @ centre
        return poses

    def _damaged(self, light: F64, rng: Draw) -> tuple[F64, np.ndarray | None]:
        """Return the readings as they are stored, and which of them are said to be clipped."""
        match self.damage:
            case "clipped":
                most = np.quantile(light, 0.8)
                said = (light >= most).any(axis=2) if rng.random() < 0.5 else None
                return np.minimum(light, most), said
            case "hot":
                light[rng.random(self.size) < 0.01] = rng.uniform(2, 30)
            case "dead row":
                light[int(rng.integers(0, self.size[0]))] = 0
            case "unit":
                light *= float(rng.choice([1e-3, 255, 65535]))
            case "black level":
                light += rng.choice([-0.3, 0.3])
            case "below zero":
                light -= light.mean()
        return light, None


def judge(seed: int) -> tuple[str, str | None]:
    """Reconstruct a drawn measurement and write its run; return a line, and what is wrong with the result, if anything.

    A typed error is a right answer; any other is what this looks for.
    """
    form = Form.draw(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            run = gs2ci.reconstruct(form.shot(), preset="draft", iterations=ITERATIONS, progress=Silent())
            with tempfile.TemporaryDirectory() as folder:
                run.save(Path(folder) / "run")
        except Gs2ciError as refusal:
            return f"refused: {refusal.problem}  {form}", None
        except Exception:
            return f"failed   {form}", traceback.format_exc()
    maps = {"views": run.views, "depth": run.depth}
    wrong = [name for name, values in maps.items() if values is not None and not np.isfinite(values).all()]
    return f"finite   {form}", f"{' and '.join(wrong)} are not finite" if wrong else None
