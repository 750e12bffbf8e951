"""Scenes and motions that no simulator's scene has, for `reliability`: what a stranger may bring.

Here: dots (soft balls before a wall), leaning walls of noise, crates (boxes of photographs) and cards (photographs),
each along a path sideways, ahead, about the scene, or sideways with a pan. Not here: their reconstruction, what is
judged.
"""

from typing import Final

import numpy as np
import skimage.data
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F32, F64
from gs2ci.core.cameras import pinhole
from gs2ci.core.records import Shot, Truth
from tests.benchmarks.photographs import Card, cards, render

SCENES: Final = ("dots", "slants", "crates", "photographs")
MOTIONS: Final = ("sideways", "dolly", "arc", "pan")
_SIZES: Final = ((64, 96), (72, 96), (96, 96), (84, 112))
_MIDDLE: Final = 2.0
_OPEN: Final = 0.25
_DOTS: Final = 250


def stranger(scene: str, motion: str, seed: int, size: tuple[int, int] | None = None) -> Shot:
    """Draw a scene of one of `SCENES` along one of `MOTIONS`; N, size, travel, noise and masks are drawn too."""
    rng = np.random.default_rng([seed, SCENES.index(scene), MOTIONS.index(motion)])
    size = _SIZES[rng.integers(len(_SIZES))] if size is None else size
    views = int(rng.choice([6, 8, 8, 10]))
    intrinsics = pinhole(float(rng.uniform(0.9, 1.4)) * size[1], size)
    poses = _path(motion, np.linspace(-0.5, 0.5, views), rng)
    if scene == "dots":
        shown = _dots(poses, intrinsics, size, rng)
    else:
        of = {"slants": _slants, "crates": _crates, "photographs": _photographs}[scene](rng)
        shown = [render(of, pose, intrinsics, size) for pose in poses]
    images, depths = (np.stack([one[i] for one in shown]) for i in (0, 1))
    masks = (rng.random((views, *size)) < _OPEN).astype(np.float32)
    noise = float(rng.uniform(0, 0.02))
    measurement = (masks[..., None] * images).sum(axis=0) + rng.normal(0, noise, (*size, 3))
    depth = np.where(np.isfinite(depths), depths, 0).astype(np.float32)
    return Shot(
        measurement.astype(np.float32),
        masks,
        intrinsics=intrinsics,
        truth=Truth(images.astype(np.float32), poses, depth),
        name=f"{scene} {motion} {seed}",
    ).check()


def _path(motion: str, steps: F64, rng: np.random.Generator) -> F64:
    """Return poses, [N, 4, 4], at steps from -0.5 to 0.5 of a path of one kind about a scene at `_MIDDLE`."""
    travel, angle = float(rng.uniform(0.08, 0.22)), float(rng.uniform(0, 2 * np.pi))
    aside = np.array([np.cos(angle), 0.5 * np.sin(angle), 0.0])
    centres, turns = steps[:, None] * travel * aside, np.zeros((len(steps), 3))
    if motion == "dolly":
        centres = steps[:, None] * float(rng.uniform(0.15, 0.4)) * np.array([0, 0, 1.0]) + 0.1 * centres
    elif motion == "arc":
        turns = np.stack([-centres[:, 1], centres[:, 0], 0 * steps], axis=1) / -_MIDDLE
        centres[:, 2] = np.square(centres).sum(axis=1) / (2 * _MIDDLE)
    elif motion == "pan":
        turns[:, 1] = steps * float(rng.uniform(0.01, 0.04)) * rng.choice([-1, 1])
    turns = turns + 0.0005 * rng.standard_normal(turns.shape)
    centres = centres + 0.003 * travel * rng.standard_normal(centres.shape)
    poses = np.tile(np.eye(4), (len(steps), 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix().transpose(0, 2, 1)
    poses[:, :3, 3] = -np.einsum("nij,nj->ni", poses[:, :3, :3], centres)
    return poses


def _noise(rng: np.random.Generator, side: int = 256) -> F64:
    """Return a picture of band-limited noise, [side, side, 3], 0 to 1."""
    found = sum(
        weight * gaussian_filter(rng.standard_normal((side, side, 3)), (sigma, sigma, 0), mode="wrap") * sigma
        for sigma, weight in ((2.0, 0.5), (6.0, 1.0), (20.0, 1.0))
    )
    return np.clip(0.5 + 0.22 * found / found.std() + rng.uniform(-0.15, 0.15, 3), 0, 1)


def _photograph(rng: np.random.Generator) -> F64:
    names = ("astronaut", "coffee", "chelsea", "rocket")
    return np.asarray(getattr(skimage.data, names[rng.integers(len(names))])(), np.float64) / 255


def _leaning(picture: F64, centre: F64, width: float, turn: Rotation) -> Card:
    """Place a picture by its centre, width and orientation."""
    right = turn.apply([width, 0, 0])
    down = turn.apply([0, width * picture.shape[0] / picture.shape[1], 0])
    return Card(picture, centre - right / 2 - down / 2, right, down)


def _slants(rng: np.random.Generator) -> tuple[Card, ...]:
    wall = _leaning(
        _noise(rng), np.array([0, 0, rng.uniform(2.6, 3.6)]), 9.0, Rotation.from_euler("yx", rng.normal(0, 0.2, 2))
    )
    return (wall, *(_slant(rng) for _ in range(rng.integers(3, 6))))


def _slant(rng: np.random.Generator) -> Card:
    deep = rng.uniform(1.3, 2.6)
    centre = np.array([*(rng.uniform(-0.4, 0.4, 2) * deep), deep])
    return _leaning(
        _noise(rng), centre, rng.uniform(0.3, 1.0), Rotation.from_euler("yxz", rng.normal(0, [0.6, 0.4, 0.5]))
    )


def _photographs(rng: np.random.Generator) -> tuple[Card, ...]:
    return cards(int(rng.integers(3)))


def _crates(rng: np.random.Generator) -> tuple[Card, ...]:
    """Return boxes of photographs on a floor before a wall."""
    found = [
        _leaning(_photograph(rng), np.array([0, 0, 3.2]), 6.0, Rotation.identity()),
        _leaning(_noise(rng), np.array([0, 0.6, 2.0]), 6.0, Rotation.from_euler("x", np.pi / 2)),
    ]
    for _ in range(rng.integers(2, 5)):
        side, turn = rng.uniform(0.25, 0.6), Rotation.from_euler("y", rng.uniform(0, np.pi / 2))
        centre = np.array([rng.uniform(-0.7, 0.7), 0.6 - side / 2, rng.uniform(1.4, 2.8)])
        for quarter in range(4):
            facing = turn * Rotation.from_euler("y", quarter * np.pi / 2)
            picture = _photograph(rng)
            low = (picture.shape[1] - picture.shape[0]) // 2
            square = picture[:, low : low + picture.shape[0]] if low > 0 else picture
            found.append(_leaning(square, centre + facing.apply([0, 0, -side / 2]), side, facing))
    return tuple(found)


def _dots(poses: F64, intrinsics: F64, size: tuple[int, int], rng: np.random.Generator) -> list[tuple[F32, F32]]:
    """Return views and depths (of half the light) of soft coloured balls before a wall of noise."""
    deep = 1 / rng.uniform(1 / 3.0, 1 / 1.2, _DOTS)
    reach = np.array(size[::-1]) / intrinsics[0, 0] / 2 * 1.3
    centres = np.column_stack([rng.uniform(-1, 1, (_DOTS, 2)) * reach * deep[:, None], deep])
    radii, colours = np.exp(rng.uniform(np.log(0.015), np.log(0.1), _DOTS)), rng.uniform(0, 1, (_DOTS, 3))
    opacity = rng.uniform(0.5, 0.98, _DOTS)
    wall = (_leaning(_noise(rng), np.array([0, 0, 3.4]), 9.0, Rotation.identity()),)
    return [_dots_seen(wall, centres, radii, colours, opacity, pose, intrinsics, size) for pose in poses]


def _dots_seen(
    wall: tuple[Card, ...],
    centres: F64,
    radii: F64,
    colours: F64,
    opacity: F64,
    pose: F64,
    intrinsics: F64,
    size: tuple[int, int],
) -> tuple[F32, F32]:
    behind, far = render(wall, pose, intrinsics, size)
    image, depth, left = np.zeros((*size, 3)), far.astype(np.float64), np.ones(size)
    rows, columns = np.mgrid[: size[0], : size[1]] + 0.5
    there = centres @ pose[:3, :3].T + pose[:3, 3]
    for k in np.argsort(there[:, 2]):
        at = intrinsics[:2, :2] @ (there[k, :2] / there[k, 2]) + intrinsics[:2, 2]
        width = np.hypot(radii[k] * intrinsics[0, 0] / there[k, 2], 0.4)
        alpha = opacity[k] * np.exp(-((columns - at[0]) ** 2 + (rows - at[1]) ** 2) / (2 * width**2))
        image += (left * alpha)[..., None] * colours[k]
        still = left * (1 - alpha)
        depth = np.where((left >= 0.5) & (still < 0.5), there[k, 2], depth)
        left = still
    return (image + left[..., None] * behind).astype(np.float32), depth.astype(np.float32)
