"""Photographs around an object, coded in software: are path and views found, in order and in no order?

    GS2CI_RINGS=FOLDER python -m tests.benchmarks photograph_rings

FOLDER holds calibrated photographs of the Middlebury multi-view stereo benchmark (Seitz et al., CVPR 2006), in the
format in which they are published: `templeRing/templeR_par.txt` and `dino/dino_par.txt` with the pictures beside them.
They are not part of the repository. The plaster objects stand before a black wall and are photographed from a gantry,
7.7° from one position to the next, with the calibration of the authors.

Eight sets in no order, eight of eleven neighbouring positions each, shuffled; and four sets of eight neighbours in
order. 240 × 320 px, colour, masks a quarter open, without noise beyond the photographs' own. Default settings. For
each: the source of the path, its error (nATE, and mean rotation), the PSNR of the views delivered, of the scene alone,
and of the decode by GAP-TV; and the seconds. `GS2CI_SETS=temple1,dino3` selects sets; `GS2CI_PATHS_ONLY=1` stops after
the first path, in views decoded by GAP-TV.
"""

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct.decode.gap_tv import gap_tv
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from gs2ci_sims.masks import random_masks
from tests.benchmarks.wide_motion import first_request
from tests.processes import side_by_side

FOLDER: Final = "GS2CI_RINGS"
PATHS_ONLY: Final = "GS2CI_PATHS_ONLY"
SIZE: Final = (240, 320)
VIEWS: Final = 8
WINDOW: Final = 11


@dataclass(frozen=True)
class Ring:
    """Photographs of one object: the file of their cameras, and the first number of each set."""

    cameras: str
    shuffled: tuple[int, ...]
    ordered: tuple[int, ...]


RINGS: Final = {
    "temple": Ring("templeRing/templeR_par.txt", (13, 16, 19, 21), (14, 20)),
    "dino": Ring("dino/dino_par.txt", (3, 15, 25, 35), (5, 30)),
}


def run() -> None:
    """Reconstruct every set."""
    if FOLDER not in os.environ:
        print(f"{FOLDER} names no folder with photographs: nothing is measured")
        return
    wanted = [name for name in os.environ.get("GS2CI_SETS", "").split(",") if name]
    for line in side_by_side(judge, [name for name in names() if not wanted or name in wanted]):
        print(line, flush=True)


def names() -> Iterator[str]:
    """Yield the names of all sets."""
    for which, ring in RINGS.items():
        yield from (f"{which}{number}" for number in range(len(ring.shuffled)))
        yield from (f"{which}{number}-ordered" for number in range(len(ring.ordered)))


def judge(name: str) -> str:
    """Reconstruct one set; return its line of the table."""
    shot = coded(name)
    assert shot.truth.views is not None
    assert shot.truth.world_to_camera is not None
    if os.environ.get(PATHS_ONLY):
        return f"{name:16} {_first_path(shot)}"
    began_s = time.monotonic()
    found = reconstruct(shot).result
    seconds = time.monotonic() - began_s
    path = trajectory_errors(np.asarray(found.world_to_camera), shot.truth.world_to_camera)
    views, scene, decode = (
        float(np.mean(psnr_per_view(one, shot.truth.views))) for one in (found.views, found.scene_views, gap_tv(shot))
    )
    doubts = sorted(note.code for note in found.notes if note.code in ("path_unconfirmed", "path_uncertain"))
    return (
        f"{name:16} {found.geometry.method:8} nATE {path.nate:.3f} {path.rotation_deg:6.1f}°  views {views:.2f}  "
        f"scene {scene:.2f}  decode {decode:.2f} dB  {seconds:.0f} s  {', '.join(doubts)}"
    )


def _first_path(shot: Shot) -> str:
    assert shot.truth.world_to_camera is not None
    found = load_geometry_prior("auto")(first_request(shot, Settings()), Silent())
    path = trajectory_errors(found.world_to_camera, shot.truth.world_to_camera)
    return f"{found.source:8} {found.verdict:12} nATE {path.nate:.3f} {path.rotation_deg:6.1f}°"


def coded(name: str) -> Shot:
    """Code the photographs of one set."""
    label, _, in_order = name.partition("-")
    which, number = label.rstrip("0123456789"), int(label[-1])
    ring = RINGS[which]
    rng = np.random.default_rng([list(RINGS).index(which), number])
    first = (ring.ordered if in_order else ring.shuffled)[number]
    positions = (
        np.arange(first, first + VIEWS) if in_order else rng.permutation(np.arange(first, first + WINDOW))[:VIEWS]
    )
    views, poses, intrinsics = photographs(Path(os.environ[FOLDER]) / ring.cameras, positions)
    masks = random_masks(VIEWS, SIZE, 0.25, rng)
    measurement = (masks[..., None] * views).sum(axis=0).astype(np.float32)
    return Shot(measurement, masks, intrinsics=intrinsics, truth=Truth(views, poses), name=name).check()


def photographs(cameras: Path, numbers: NDArray[np.int64]) -> tuple[F32, F64, F64]:
    """Read photographs by the numbers at the ends of their names: views, poses, and their common camera matrix.

    A line of the file holds a name, K and R row by row, and t (`README.txt` beside it); pixel centres are at 0 there.
    """
    lines = [line.split() for line in cameras.read_text().splitlines()[1:] if line.strip()]
    by_number = {int(Path(line[0]).stem[-4:]): line for line in lines}
    views, poses, intrinsics = [], [], np.eye(3)
    for number in numbers:
        line = by_number[int(number)]
        picture = cv2.imread(str(cameras.parent / line[0]))
        assert picture is not None, f"{line[0]} is not there"
        scale = SIZE[0] / picture.shape[0]
        views.append(cv2.resize(picture[..., ::-1].astype(np.float32) / 255, SIZE[::-1], interpolation=cv2.INTER_AREA))
        values = np.array(line[1:], np.float64)
        intrinsics = values[:9].reshape(3, 3)
        intrinsics[:2, 2] += 0.5
        intrinsics[:2] *= scale
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = values[9:18].reshape(3, 3), values[18:]
        poses.append(pose)
    return np.stack(views), np.stack(poses), intrinsics
