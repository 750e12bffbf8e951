"""Shots as laboratories take them, drawn at random: are their masks corrected rightly, and what is recovered?

    python -m tests.benchmarks laboratory                    registration of 36 draws
    GS2CI_WHOLE=1 python -m tests.benchmarks laboratory      and their reconstruction, some minutes each
    GS2CI_DRAWS=3,9,12 python -m tests.benchmarks laboratory    these draws alone

Data: rendered rooms, 240 × 192 px, of meshes with photographs of scikit-image and plain paints; a camera that travels
along a line, an arc or its view, evenly, easing or in stairs, and moves while a mask is on show; 8 to 24 views; grey,
colour and mosaic sensors with photon and read noise of 400 to 20,000 electrons and ten bits. Masks with elements of 1
to 3 px, drawn anew for each view or one pattern displaced by 2 px a view, soft, with a leak of 2 % and a vignetting of
up to 30 %; stated with a noise of 1 %, and for half of the shots displaced by up to 2 px, by bilinear interpolation.

`off` is how far the corrected masks lie from the true ones, px, at the worst corner; `level` the mean transmission of
the corrected masks over that of the true ones: views are brighter by its inverse.
"""

import os
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
import skimage.data

from gs2ci.core.arrays import F32, F64
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.registration.register import RegistrationSettings, register
from gs2ci_sims.rays.meshes import TexturedMesh, trace_mesh
from gs2ci_sims.scenes.meshes import MeshBuilder
from gs2ci_sims.scenes.rectangles import Rectangle, box, rotation
from gs2ci_sims.scenes.stage import SuggestedCamera, floor_y
from tests.processes import side_by_side
from tests.tables.order import depth_rank

SIZE, FINER, MOMENTS = (192, 240), 2, 3
BACK = 6.0
PHOTOGRAPHS = ("coffee", "chelsea", "astronaut", "rocket", "retina", "immunohistochemistry")
LEAK, OPEN, VIGNETTING = 0.02, 0.96, 0.3
STATED_NOISE, READ_NOISE_E, STEPS = 0.01, 3.0, 1023


@dataclass(frozen=True)
class Drawn:
    """A drawn shot, its true masks, [N, H, W], depth of its middle view, [H, W], the masks' shift, and all in words."""

    shot: Shot
    masks: F32
    depth: F64
    shift_px: F64
    words: str


class _Room(MeshBuilder):
    """Paints surfaces with pieces of photographs, or plainly with this probability."""

    plain = 0.0

    def _texture(self, lengths: F64, depth: float) -> F64:
        height, width = np.clip(self._frame.focal * lengths / depth, 4, 2048).astype(int)
        colour = self._rng.uniform(0.2, 0.9, 3)
        if self._rng.random() < self.plain:
            soft = cv2.resize(self._rng.normal(0, 0.05, (3, 3, 3)), (width, height), interpolation=cv2.INTER_CUBIC)
            return np.asarray(np.clip(colour * (1 + soft), 0, 1), np.float64)
        name = PHOTOGRAPHS[self._rng.integers(len(PHOTOGRAPHS))]
        photograph = getattr(skimage.data, name)()[..., :3].astype(np.float64) / 255
        share = self._rng.uniform(0.4, 1)
        rows, columns = (int(side * share) for side in photograph.shape[:2])
        top = self._rng.integers(0, photograph.shape[0] - rows + 1)
        left = self._rng.integers(0, photograph.shape[1] - columns + 1)
        piece = photograph[top : top + rows, left : left + columns]
        fitted = cv2.resize(piece, (width, height), interpolation=cv2.INTER_AREA)
        return np.asarray(np.clip(fitted * 0.9 + 0.05, 0, 1), np.float64)


def _room(rng: np.random.Generator, frame: SuggestedCamera) -> TexturedMesh:
    room, half = _Room(rng, frame), frame.half
    room.plain = float(rng.uniform(0, 0.5))
    (wide, high), down = 2.6 * BACK * half, floor_y(frame, BACK)
    room.rectangle(Rectangle(np.array([0, 0, BACK]), np.array([wide, 0, 0]), np.array([0, high, 0])))
    near = 0.4 * down / half[1]
    middle, reach = 0.5 * (near + BACK), 0.5 * (BACK - near)
    room.rectangle(Rectangle(np.array([0, down, middle]), np.array([wide, 0, 0]), np.array([0, 0, reach])))
    for _ in range(rng.integers(2, 7)):
        edges, z = rng.uniform(0.06, 0.2, 3) * BACK * half.min(), rng.uniform(0.5, 0.9) * BACK
        centre = np.array([rng.uniform(-0.8, 0.8) * half[0] * z, down - edges[1], z])
        for face in box(centre, rotation(np.array([0, rng.uniform(-0.7, 0.7), 0])) * edges):
            room.rectangle(face)
    for _ in range(rng.integers(0, 4)):
        radius, z = rng.uniform(0.06, 0.16) * BACK * half.min(), rng.uniform(0.55, 0.85) * BACK
        room.ball(np.array([rng.uniform(-0.7, 0.7) * half[0] * z, down - radius, z]), radius)
    return room.mesh()


def _poses(path: str, views: int, travel: float, angle: float, distance: float) -> F64:
    """Return the poses of each moment of each view, [N × moments, 4, 4]."""
    time = (np.arange(views * MOMENTS) / MOMENTS - views // 2 - 1 / 3) / (views - 1)
    if path == "ease":
        time = np.sign(time) * np.abs(2 * time) ** 1.5 / 2
    if path == "stairs":
        time = (np.repeat(np.arange(views), MOMENTS) - views // 2) / (views - 1)
    way = np.array([np.cos(angle), 0.6 * np.sin(angle), 0])
    poses = np.tile(np.eye(4), (len(time), 1, 1))
    for pose, now in zip(poses, time, strict=True):
        centre = way * travel * now
        if path == "arc":
            turn = centre / distance
            pose[:3, :3] = cv2.Rodrigues(np.array([-turn[1], turn[0], 0]))[0]
        if path == "in":
            centre = 0.5 * centre + np.array([0, 0, 1.2 * travel * now])
        pose[:3, 3] = -pose[:3, :3] @ centre
    return poses


def _masks(rng: np.random.Generator, views: int) -> tuple[F32, str]:
    """Draw true masks, [N, H, W]."""
    height, width = SIZE
    element, share = int(rng.choice([1, 1, 2, 3])), float(rng.choice([0.25, 0.5]))
    blur_px = float(rng.uniform(0.2, 0.9))
    drawn = rng.random((views, height // element + 2, width // element + 2)) < share
    kind, square = str(rng.choice(["anew", "displaced"])), np.ones((element, element))
    if kind == "displaced":
        pattern = np.kron(rng.random(((height + 4 * views) // element + 2, width // element + 2)) < 0.5, square)
        opened = [pattern[2 * k : 2 * k + height, :width] for k in range(views)]
    else:
        opened = [np.kron(one, square)[:height, :width] for one in drawn]
    y, x = np.mgrid[:height, :width]
    vignetting = 1 - 2 * VIGNETTING * ((y / height - 0.5) ** 2 + (x / width - 0.5) ** 2)
    soft = [cv2.GaussianBlur(one.astype(np.float32), (0, 0), blur_px) for one in opened]
    masks = np.stack([LEAK + OPEN * one * vignetting for one in soft]).astype(np.float32)
    return masks, f"{kind}, {element} px, {np.mean(opened):.0%} open, σ {blur_px:.1f} px"


def drawn(seed: int) -> Drawn:
    """Draw a shot."""
    rng = np.random.default_rng([151, seed])
    frame = SuggestedCamera((SIZE[0] * FINER, SIZE[1] * FINER), float(rng.uniform(22, 60)))
    room, fine = _room(rng, frame), frame.intrinsics
    views, sensor = int(rng.choice([8, 8, 12, 16, 24])), str(rng.choice(["mono", "rgb", "RGGB"]))
    path = str(rng.choice(["line", "arc", "in", "ease", "stairs"]))
    far = trace_mesh(room, np.eye(4), fine, frame.size)[1]
    least, most = np.percentile(far[np.isfinite(far)], [2, 98])
    parallax_px = float(np.exp(rng.uniform(np.log(2), np.log(25))))
    travel = parallax_px * FINER / (fine[0, 0] * (1 / least - 1 / most))
    poses = _poses(path, views, travel, rng.uniform(0, 2 * np.pi), float(np.median(far[np.isfinite(far)])))
    seen = [np.nan_to_num(trace_mesh(room, pose, fine, frame.size)[0]) for pose in poses]
    small = np.stack([one.reshape(SIZE[0], FINER, SIZE[1], FINER, 3).mean((1, 3)) for one in seen])
    truth = np.clip(small.reshape(views, MOMENTS, *SIZE, 3).mean(axis=1), 0, 1)
    truth = truth.mean(axis=-1, keepdims=True) if sensor == "mono" else truth
    masks, kind = _masks(rng, views)
    light = (masks[..., None] * truth).sum(axis=0)
    if sensor == "RGGB":
        rows, columns = np.mgrid[: SIZE[0], : SIZE[1]] % 2
        light = np.take_along_axis(light, (rows + columns)[..., None], axis=2)
    white, electrons = light.max() * 1.05, float(np.exp(rng.uniform(np.log(400), np.log(20000))))
    counted = rng.poisson(light / white * electrons) + rng.normal(0, READ_NOISE_E, light.shape)
    measured = np.round(counted / electrons * STEPS) / STEPS * white
    shift = (rng.uniform(-2, 2, 2) if rng.random() < 0.5 else np.zeros(2)).astype(np.float32)
    moved = np.array([[1, 0, shift[1]], [0, 1, shift[0]]], np.float32)
    warped = partial(cv2.warpAffine, M=moved, dsize=SIZE[::-1], borderMode=cv2.BORDER_REPLICATE)
    stated = np.stack([warped(one) for one in masks]) if shift.any() else masks
    stated = np.clip(stated + STATED_NOISE * rng.standard_normal(stated.shape), 0, 1).astype(np.float32)
    intrinsics = fine.copy()
    intrinsics[:2] /= FINER
    known = rng.random() < 0.5
    middle = poses[MOMENTS // 2 :: MOMENTS]
    shot = Shot(
        measured.astype(np.float32),
        stated,
        cfa="RGGB" if sensor == "RGGB" else None,
        intrinsics=intrinsics if known else None,
        truth=Truth(truth.astype(np.float32), middle),
    ).check()
    depth = trace_mesh(room, middle[views // 2], intrinsics, SIZE)[1]
    words = f"{views} views, {sensor}, {path}, {parallax_px:.0f} px of parallax, {electrons:.0f} e; {kind}"
    return Drawn(shot, masks, depth, shift.astype(np.float64), words)


def _registered(one: Drawn) -> str:
    found = register(one.shot, RegistrationSettings())
    off_px = float(np.abs(found.misfit.placement.displacement_px(SIZE) + one.shift_px).max())
    level = float(found.shot.masks.mean() / one.masks.mean())
    stated_px = float(np.abs(one.shift_px).max())
    return f"off {off_px:.2f} px (stated {stated_px:.2f}), level {level:.3f}, leak {found.misfit.leak:+.3f}"


def _reconstructed(one: Drawn) -> str:
    result, truth = reconstruct(one.shot, progress=Silent()).result, one.shot.truth
    assert truth.views is not None
    assert truth.world_to_camera is not None
    psnr_db = [
        -10 * np.log10(np.mean((np.clip(views, 0, 1) - truth.views) ** 2))
        for views in (result.views, result.scene_views, result.decode)
    ]
    path = trajectory_errors(result.world_to_camera, truth.world_to_camera)
    assert result.depth is not None
    depth = result.depth[len(truth.views) // 2]
    rank = depth_rank(depth, one.depth) or 0.0
    said = " ".join(note.code.value for note in result.notes)
    return (
        f"views {psnr_db[0]:.2f}, scene {psnr_db[1]:.2f}, decode {psnr_db[2]:.2f} dB; {result.geometry.method} "
        f"{result.geometry.verdict}, nATE {path.nate or np.nan:.3f}, order of depth {rank:+.2f}; {said}"
    )


def _row(seed: int, *, whole: bool) -> str:
    one = drawn(seed)
    return f"{seed:3d} {one.words}: {_registered(one)}" + (f"\n    {_reconstructed(one)}" if whole else "")


def run() -> None:
    """Print a row for each draw."""
    asked = os.environ.get("GS2CI_DRAWS")
    seeds = range(36) if asked is None else [int(one) for one in asked.split(",")]
    for row in side_by_side(partial(_row, whole="GS2CI_WHOLE" in os.environ), seeds):
        print(row, flush=True)
