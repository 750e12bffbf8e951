"""Moving scenes: static model, moving model and decode against the truth, and the cost of the test on static scenes.

    python -m tests.benchmarks moving

Three parts. Simulated moving objects under a moving camera, three scenes, each beside itself at rest (data: the
project's simulator; its bench integrates the light over the exposure, from its own renderer), with `--motion auto` and
`off`: what motion gains, and what the test for motion costs a still scene, in dB and processor seconds. The first
blocks of the video clips in `video_sci` of GS2CI_SHARED_DATA or `../shared/data`, cropped to their middle, if they
exist (data: the benchmarks of the PnP-SCI authors). The real measurements in `real_cacti` beside them, likewise
cropped, by their held-out residual alone.

Settings of the environment:

    GS2CI_MOVING_SEEDS=3         seeds of the simulated scenes (1)
    GS2CI_MOVING_CROP_PX=256     side of the crops; 256 takes the clips whole (96)
    GS2CI_MOVING_ONLY=traffic48  what is measured: names of scenes, or parts of names of files, separated by commas
"""

import os
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot, Truth
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.settings import Settings
from gs2ci_sims.effects.object_motion import ObjectMotion
from tests.benchmarks.decoders import data_folder
from tests.stability.benches import INTERVAL_S, Bench, build

SCENES = ("boxes", "thicket", "moving")
SIZE = (72, 96)
WAY_PX = 8.0
VIEWS = 8


def run() -> None:
    seeds, crop = (int(os.environ.get(f"GS2CI_MOVING_{name}", some)) for name, some in (("SEEDS", 1), ("CROP_PX", 96)))
    only = [name for name in os.environ.get("GS2CI_MOVING_ONLY", "").split(",") if name]
    for scene in SCENES:
        for seed in range(seeds) if not only or scene in only else ():
            _compare(f"{scene}, seed {seed}", _simulated(scene, seed, 0.0), _simulated(scene, seed, WAY_PX))
    for name, shot in clips(crop, only):
        _report(name, shot, Settings())
        _report(f"{name}, --motion off", shot, replace(Settings(), motion="off"))


def _compare(name: str, still: Shot, moving: Shot) -> None:
    _report(f"{name}, at rest", still, Settings())
    _report(f"{name}, at rest, --motion off", still, replace(Settings(), motion="off"))
    _report(f"{name}, moves {WAY_PX:g} px", moving, Settings())
    _report(f"{name}, moves {WAY_PX:g} px, --motion off", moving, replace(Settings(), motion="off"))


def _report(name: str, shot: Shot, settings: Settings) -> None:
    began_s = time.process_time()
    result = reconstruct(shot, settings, Silent()).result
    seconds = time.process_time() - began_s
    truth = shot.truth.views
    quality = (
        ""
        if truth is None
        else " ".join(
            f"{what} {np.mean(psnr_per_view(views, truth)):5.2f}"
            for what, views in (("views", result.views), ("scene", result.scene_views), ("decode", result.decode))
        )
    )
    held = result.heldout_rms[result.verdict]
    left = "" if held is None else f"held-out {held:.4f} (decode {result.heldout_rms['decode']:.4f})"
    chosen = result.motion.chosen
    print(f"{name:40} {quality} {left} {result.verdict}, {chosen}, {seconds:.0f} s of processor", flush=True)


def _simulated(scene: str, seed: int, way_px: float) -> Shot:
    """Expose a scene in which a ball of a third of the nearest depth moves sideways by so many px."""
    built = build(scene, SIZE)
    depth = 1.1 * built.depth_range()[0]
    camera_to_world = np.linalg.inv(built.world_to_camera)
    centre = (camera_to_world @ np.array([0.0, 0.0, depth, 1.0]))[:3]
    duration_s = VIEWS * INTERVAL_S
    velocity = camera_to_world[:3, 0] * (way_px * depth / built.intrinsics[0, 0] / duration_s)
    thing = ObjectMotion(tuple(centre), 0.35 * depth, tuple(velocity))
    return Bench(scene=scene, views=VIEWS, effects=(thing,) if way_px else ()).expose(SIZE, seed)


def clips(side: int, only: list[str]) -> Iterator[tuple[str, Shot]]:
    for path in _wanted("video_sci", only):
        found = loadmat(path)
        masks = np.moveaxis(found["mask"].astype(np.float32), 2, 0)
        measured = found["meas"][:, :, 0].astype(np.float32) / 255
        truth = np.moveaxis(found["orig"][:, :, : len(masks)].astype(np.float32) / 255, 2, 0)
        yield path.stem, _cropped(measured, masks, truth, side)
    for path in _wanted("real_cacti", only):
        found = loadmat(path)
        masks = np.moveaxis(found["mask"].astype(np.float32), 2, 0)
        masks /= masks.max()
        # The unit is not known: the mean of the readings is that of a scene of middle grey.
        measured = found["meas"].astype(np.float32)
        measured *= 0.4 * masks.sum(axis=0).mean() / measured.mean()
        yield path.stem, _cropped(measured, masks, None, side)


def _wanted(folder: str, only: list[str]) -> list[Path]:
    files = sorted((data_folder() / folder).glob("*.mat"))
    return [path for path in files if not only or any(name in path.stem for name in only)]


def _cropped(measured: np.ndarray, masks: np.ndarray, truth: np.ndarray | None, side: int) -> Shot:
    first = max(0, (measured.shape[0] - side) // 2), max(0, (measured.shape[1] - side) // 2)
    part = np.s_[first[0] : first[0] + side, first[1] : first[1] + side]
    weights = np.ones(len(masks), np.float32)
    views = None if truth is None else truth[:, *part, None]
    return Shot(measured[part][..., None], masks[:, *part], weights, truth=Truth(views=views)).check()
