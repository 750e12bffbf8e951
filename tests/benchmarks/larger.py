"""This checkout against another at the sizes people use: photographs on cards and balls before a wall, drawn anew.

    GS2CI_SEED=7 GS2CI_AGAINST=87ce80b7 python -m tests.benchmarks larger

180 x 240 to 270 x 480 px, 8 to 16 views, noise of 1 to 2 %, seen by rays (`photographs.py`, no Gaussians). The camera
passes sideways, goes ahead, around the scene, and passes while it pans, in turns. Both checkouts reconstruct each draw
as in `checkouts`. Of each it prints, this checkout's figure first: PSNR of delivered views, of the scene, and of the
scene half way between the two middle views; the depth's median error; the path's (nATE); processor seconds. The last
line has means.

| variable | what it sets | default |
|---|---|---|
| `GS2CI_SEED` | which scenes, paths, masks and noise | 0 |
| `GS2CI_DRAWS` | which draws of the seed | 0:4 |
| `GS2CI_AGAINST`, `GS2CI_PRESET` | as of `checkouts` | 87ce80b7, standard |
"""

import os
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import numpy as np
import skimage.data
from scipy.spatial.transform import Rotation

from gs2ci.core.arrays import F64
from gs2ci.core.cameras import pinhole
from gs2ci.core.records import Shot, Truth
from gs2ci.core.storage import write_shots
from tests.benchmarks.checkout_side import Found
from tests.benchmarks.checkouts import ROOT, Side, asked, checkout, write
from tests.benchmarks.photographs import Ball, Card, placed, render

KINDS: Final = ("sideways", "ahead", "around", "pan")
SIZES: Final = ((180, 240), (192, 256), (240, 320), (270, 480))
PICTURES: Final = ("coffee", "astronaut", "chelsea", "rocket", "immunohistochemistry", "camera", "coins", "gravel")
FIGURES: Final = {
    "psnr_db": ("views, dB", 1, 2),
    "scene_db": ("scene, dB", 1, 2),
    "between_db": ("between, dB", 1, 2),
    "depth_off": ("depth off, %", 100, 2),
    "nate": ("path, nATE", 1, 4),
    "seconds": ("processor s", 1, 0),
}
"""Of `Found`: heading, factor and digits."""


def run() -> None:
    """Ask both checkouts in turns, print a row for each draw, and the means."""
    seed, preset = int(os.environ.get("GS2CI_SEED", "0")), os.environ.get("GS2CI_PRESET", "standard")
    first, last = (int(part) for part in os.environ.get("GS2CI_DRAWS", "0:4").split(":"))
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        other = stack.enter_context(checkout(os.environ.get("GS2CI_AGAINST", "87ce80b7")))
        sides, small = [], asked(write(folder, "boxes", 0, "48x64"), "boxes", 0, "draft")
        for one in (ROOT, other):
            sides.append(Side(one))
            stack.callback(sides[-1].close)
            sides[-1].ask(small)  # compiles
        print("| draw | " + " | ".join(heading for heading, _, _ in FIGURES.values()) + " |")
        print("|---|" + "---:|" * len(FIGURES))
        pairs = []
        for number in range(first, last):
            shot, between = draw(seed, number)
            file = write_shots(folder / f"{seed}-{number}.h5", [shot])
            np.save(file.with_suffix(".npy"), between[None])
            order = (0, 1) if number % 2 == 0 else (1, 0)
            found = {k: sides[k].ask(asked(file, shot.name, 0, preset)) for k in order}
            pairs.append((found[0], found[1]))
            print(f"| {shot.name} | {' | '.join(_pair(*pairs[-1], key) for key in FIGURES)} |", flush=True)
    print(f"| mean of this less other; ratio of seconds | {' | '.join(_mean(pairs, key) for key in FIGURES)} |")


def _pair(this: Found, other: Found, key: str) -> str:
    _, factor, digits = FIGURES[key]
    return " ".join("–" if side.get(key) is None else f"{factor * side[key]:.{digits}f}" for side in (this, other))  # type: ignore[literal-required]


def _mean(pairs: list[tuple[Found, Found]], key: str) -> str:
    _, factor, digits = FIGURES[key]
    both = [(this[key], other[key]) for this, other in pairs]  # type: ignore[literal-required]
    known = np.array([one for one in both if None not in one], np.float64)
    if key == "seconds":
        return f"{np.exp(np.log(known[:, 0] / known[:, 1]).mean()):.2f}"
    return f"{factor * np.mean(known[:, 0] - known[:, 1]):+.{digits}f}" if len(known) else "–"


def draw(seed: int, number: int) -> tuple[Shot, np.ndarray]:
    """Draw a scene and a path, and code its views; also return the view half way between the two middle ones."""
    rng = np.random.default_rng([seed, number])
    kind, size = KINDS[number % len(KINDS)], SIZES[(number + seed) % len(SIZES)]
    views, noise, grey = int(rng.integers(8, 17)), float(rng.uniform(0.01, 0.02)), rng.random() < 0.25
    scene, intrinsics = scene_of(rng), pinhole(1.1 * size[1], size)
    along = np.linspace(-0.5, 0.5, views)
    poses = path(kind, np.append(along, along[views // 2 - 1 :][:2].mean()), rng)
    images, depths = (
        np.stack(part) for part in zip(*(render(scene, pose, intrinsics, size) for pose in poses), strict=True)
    )
    images = images.mean(axis=-1, keepdims=True) if grey else images
    masks = (rng.random((views, *size)) < rng.choice([0.25, 0.5])).astype(np.float32)
    coded = (masks[..., None] * images[:-1]).sum(axis=0)
    coded += rng.normal(0, noise, coded.shape)
    shot = Shot(
        coded.astype(np.float32),
        masks,
        intrinsics=intrinsics,
        truth=Truth(images[:-1], poses[:-1], depths[:-1]),
        name=f"{seed}/{number} {kind}{', grey' if grey else ''}, {size[0]}x{size[1]}x{views}, {noise:.1%}",
    )
    return shot.check(), images[-1]


def scene_of(rng: np.random.Generator) -> list[Card | Ball]:
    """Draw a wall that leans, and two to four cards and one or two balls before it."""
    names = rng.permutation(PICTURES)
    wall, *others = (_picture(name, rng) for name in names)
    scene: list[Card | Ball] = [placed(wall, (0, 0, rng.uniform(2.5, 3)), 5.5, tuple(rng.uniform(-0.5, 0.5, 2)))]
    for picture in others[: rng.integers(2, 5)]:
        depth = rng.uniform(1.4, 2.3)
        centre = (*(rng.uniform(-0.35, 0.35, 2) * depth * (1, 0.7)), depth)
        scene.append(placed(picture, centre, rng.uniform(0.35, 0.8), tuple(rng.uniform(-0.2, 0.2, 2))))
    for picture in others[-rng.integers(1, 3) :]:
        depth = rng.uniform(1.5, 2.2)
        scene.append(Ball(picture, np.array([*(rng.uniform(-0.3, 0.3, 2) * depth), depth]), rng.uniform(0.12, 0.25)))
    return scene


def _picture(name: str, rng: np.random.Generator) -> F64:
    """Return three quarters of a sample photograph, in colour."""
    picture = np.asarray(getattr(skimage.data, name)(), np.float64) / 255
    picture = picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)
    height, width = (3 * side // 4 for side in picture.shape[:2])
    top, left = (int(rng.integers(0, side // 4)) for side in picture.shape[:2])
    return picture[top : top + height, left : left + width]


def path(kind: str, along: F64, rng: np.random.Generator) -> F64:
    """Return world-to-camera poses, [len(along), 4, 4], at places from -0.5 to 0.5 of a path."""
    travel, angle, bend = rng.uniform(0.1, 0.2), rng.uniform(0, 2 * np.pi), rng.uniform(-0.03, 0.03)
    across = np.array([np.cos(angle), np.sin(angle), 0])
    aside = np.array([-np.sin(angle), np.cos(angle), rng.uniform(-1, 1)])
    centres = along[:, None] * travel * across + np.square(along)[:, None] * bend * aside
    # Rotation vectors of the camera, rad: about `across` x z, the axis by which it follows what it passes.
    turns = along[:, None] * rng.normal(0, 0.004, 3)
    follow = np.cross([0, 0, 1], across)
    if kind == "ahead":
        centres = along[:, None] * (2 * travel * np.array([0, 0, 1]) + 0.3 * travel * across)
    elif kind == "around":
        # About a point in the middle of the scene, so that it stays in the middle of the picture.
        turns = turns - along[:, None] * travel / 2 * follow
        centres[:, 2] += np.square(along * travel) / 4
    elif kind == "pan":
        turns = turns + along[:, None] * rng.uniform(-0.06, 0.06) * follow
    poses = np.tile(np.eye(4), (len(along), 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix().transpose(0, 2, 1)
    poses[:, :3, 3] = -np.einsum("nij,nj->ni", poses[:, :3, :3], centres)
    return poses
