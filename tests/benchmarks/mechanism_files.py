"""Measurements on which no mechanism was made, as files for `python -m tests.tables ablation --mechanisms --data`.

    GS2CI_OUT=measurements GS2CI_SHARED_DATA=FOLDER python -m tests.benchmarks mechanism_files

Of 96 x 128 px, with draws of a seed that no other benchmark uses: photographs on planes with 2 % noise, one before a
plain wall; textured meshes by rays; random scenes of `depth_order`; families of hard cases; and, if the folder holds
them, crops of the path-traced light field (of which the outer pictures are not coded), of real photographs far apart,
of grey clips, and of a real exposure without a truth, which only its held-out pixels judge.

| variable | what it sets | default |
|---|---|---|
| `GS2CI_OUT` | the folder | measurements |
| `GS2CI_SEED` | of all draws | 5800 |
"""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.crop import middle
from gs2ci.core.foreign.assemble import import_shots
from gs2ci.core.foreign.options import ImportOptions
from gs2ci.core.records import Shot
from gs2ci.core.storage import write_shots
from tests.benchmarks import depth_order
from tests.benchmarks.beside_files import SHARED, write_light_field
from tests.benchmarks.own_model_class import MESHES, RAYS_THROUGH_MESHES, taken
from tests.benchmarks.photographs import cards, expose, render
from tests.stability.cases import CASES

SIZE = (96, 128)
SEED = int(os.environ.get("GS2CI_SEED", "5800"))
NOISE = 0.02
WALL_BLUR = 0.05
ORDERS = 6
HARD = (
    "motion: 1 px of parallax",
    "motion: turns by 3° on the spot",
    "motion: to and fro, 4 turns",
    "motion: none",
    "views: 16",
    "mask ratio: 0.75",
    "wrong masks: shifted by 0.5 px",
    "scene: stripes",
    "moving object: 0.6 units, 3 away",
)


def run() -> None:
    """Write the files, and name them."""
    folder = Path(os.environ.get("GS2CI_OUT", "measurements"))
    folder.mkdir(parents=True, exist_ok=True)
    for name, shot, views, depth in measurements():
        print(write_shots(folder / f"{name}.h5", [shot]))
        if views is not None:
            known = {} if depth is None else {"depth": depth}
            np.savez_compressed(folder / f"{name}.beside.npz", views=views, **known)
    if (SHARED / "lightfield" / "antinous.npz").is_file():
        print(write_light_field(folder, SHARED / "lightfield"))


def measurements() -> Iterator[tuple[str, Shot, F32 | None, F32 | None]]:
    """Yield name, measurement, true views beside its path if known, and the depth from the first of them."""
    for which in range(3):
        blur = WALL_BLUR if which == 2 else 0.0
        shot, _, (views, poses) = expose(which, SEED + which, size=SIZE, noise=NOISE, blur=blur)
        assert shot.intrinsics is not None
        depth = render(cards(which, blur), poses[0], shot.intrinsics, SIZE)[1]
        yield f"cards_{which}", shot, views, np.where(np.isfinite(depth), depth, 0).astype(np.float32)
    for name in MESHES:
        yield f"mesh_{name}", taken(name, RAYS_THROUGH_MESHES, SEED, SIZE), None, None
    for number in range(ORDERS):
        trial = depth_order.draw(number, SEED)
        shot = trial.shot
        depths = np.zeros((shot.views, *shot.size), np.float32)
        depths[shot.views // 2] = trial.scene.depth
        told = shot.truth.depth if shot.truth.depth is not None else depths
        yield f"order_{number}", replace(shot, truth=replace(shot.truth, depth=told)), None, None
    for case in CASES:
        if case.title in HARD:
            name = "hard_" + "".join(one if one.isalnum() else "_" for one in case.title)
            yield name, case.change(case.bench.expose(SIZE, SEED)), None, None
    yield from _shared()


def _shared() -> Iterator[tuple[str, Shot, F32 | None, F32 | None]]:
    files = {
        "photographs_far_apart": "fern_photos_wide.npz",
        "clip_runner": "video_sci/runner40_cacti.mat",
        "clip_traffic": "video_sci/traffic48_cacti.mat",
        "clip_drop": "video_sci/drop40_cacti.mat",
        "exposure_fan": "real_cacti/4fan14_cacti.mat",
    }
    for name, file in files.items():
        if (SHARED / file).is_file():
            shot = import_shots(SHARED / file, None, ImportOptions()).shots[0]
            yield name, middle(shot, SIZE).check(), None, None
