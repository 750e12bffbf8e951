"""Files for `python -m tests.tables --data`: measurements made without a Gaussian renderer, views beside the path.

    GS2CI_OUT=measurements GS2CI_SIZE="96 128" GS2CI_SHARED_DATA=FOLDER python -m tests.benchmarks beside_files

It writes three arrangements of photographs on planes, ray traced and coded with 1 % noise, and, if the folder holds
`lightfield/`, its path-traced scene, coded without noise. Each `NAME.npz` has a `NAME.beside.npz` with the images half
way between the two middle poses and one step beyond the last, and the true depth of the former.

The light field has nine pictures along its rail. Those at places 1, 2, 3, 5, 6 and 7 are coded, with the file's own
masks; picture 4 is the view between, 8 the view beyond, so that both are renderings of the path tracer.
"""

import os
from pathlib import Path

import numpy as np

from gs2ci.core.arrays import F32, F64
from tests.benchmarks.photographs import cards, expose, render

SHARED = Path(os.environ.get("GS2CI_SHARED_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
NOISE = 0.01
"""Of the photographs on planes, in full scales of one view."""


def run() -> None:
    """Write the files, and name them."""
    folder = Path(os.environ.get("GS2CI_OUT", "measurements"))
    height, width = (int(side) for side in os.environ.get("GS2CI_SIZE", "192 256").split())
    folder.mkdir(parents=True, exist_ok=True)
    for which in range(3):
        print(write_planes(folder, which, (height, width)))
    if (SHARED / "lightfield" / "antinous.npz").is_file():
        print(write_light_field(folder, SHARED / "lightfield"))
    else:
        print(f"(no light field at GS2CI_SHARED_DATA={SHARED})")


def write_planes(folder: Path, which: int, size: tuple[int, int]) -> Path:
    """Write an arrangement of photographs on planes, the seed being its number; return the measurement's path."""
    shot, _, (views, poses) = expose(which, seed=which, size=size, noise=NOISE)
    assert shot.intrinsics is not None
    assert shot.truth.views is not None
    assert shot.truth.world_to_camera is not None
    _, depth = render(cards(which), poses[0], shot.intrinsics, size)
    known: dict[str, F32 | F64] = {"K": shot.intrinsics, "world_to_camera": shot.truth.world_to_camera}
    file = folder / f"planes_{which}.npz"
    np.savez_compressed(file, meas=shot.measurement, masks=shot.masks, truth=shot.truth.views, **known)
    np.savez_compressed(file.with_suffix(".beside.npz"), views=views, depth=np.where(np.isfinite(depth), depth, 0))
    return file


def write_light_field(folder: Path, source: Path) -> Path:
    """Write the light field coded anew without its outer pictures; return the measurement's path."""
    with np.load(source / "antinous.npz") as held:
        arrays = {name: held[name] for name in ("masks", "truth", "K", "world_to_camera")}
    with np.load(source / "antinous_between.npz") as held:
        between, disparity = held["view"], held["disparity"].astype(np.float64)
    coded = slice(1, 7)
    masks, truth = arrays["masks"][coded], arrays["truth"][coded]
    measurement = np.einsum("nhw,nhwc->hwc", masks.astype(np.float64), truth / 255)
    file = folder / "lightfield_6.npz"
    told = {"K": arrays["K"], "world_to_camera": arrays["world_to_camera"][coded]}
    np.savez_compressed(file, meas=measurement.astype(np.float32), masks=masks, truth=truth, **told)
    views = np.stack([between, arrays["truth"][7]])
    # Disparity of one step of the rail, px; poses are in steps of the rail.
    focal_px = float(arrays["K"][0, 0])
    depth = np.where(disparity > 0, focal_px / np.where(disparity > 0, disparity, 1), 0).astype(np.float32)
    np.savez_compressed(file.with_suffix(".beside.npz"), views=views, depth=depth)
    return file
