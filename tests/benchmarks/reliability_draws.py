"""Measurements of known truth for `reliability`: drawn scenes, photographs on planes, meshes and a light field.

Here: the draws. Not here: their reconstruction, and what is judged (`reliability`).
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32
from gs2ci.core.crop import middle
from gs2ci.core.records import Shot, Truth
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.light_path import sensor_effects
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import StageMove, stage_move_for_parallax
from gs2ci_sims.rig import Light, ModulatorFigures, RigFigures
from gs2ci_sims.scenes.files import LIBRARY, load_scene
from gs2ci_sims.scenes.stage import SuggestedCamera
from tests.benchmarks import photographs
from tests.exposing import expose
from tests.tables.cases import noisy, staged

SIZE: Final = tuple(int(side) for side in os.environ.get("GS2CI_SIZE", "72x96").split("x"))
MASKS: Final = 8
# Names of the simulator's scenes; corridors are driven into and passed sideways, and some have a stage.
KINDS: Final = (
    "planes",
    "boxes",
    "thicket",
    "ball",
    "corridor",
    "corridor sideways",
    "boxes staged",
    "corridor staged",
    "glossy",
    "blocks",
    "cards",
    "planes noisy",
    "boxes noisy",
)
_PARALLAX_PX: Final = (4.0, 14.0)
# As much as a stage whose errors are not stated is taken to err by.
_STAGE_OFF: Final = 0.01
_NOISE: Final = (0.05, 0.2)
_PHOTONS: Final = (1000.0, 4180.0)


@dataclass(frozen=True)
class Draw:
    """A measurement with its name; the truth is in the shot, depth [N, H, W] with 0 where it is not known."""

    name: str
    shot: Shot


def drawn(kind: str, seed: int) -> Draw:
    """Draw a scene of one kind, its path, masks and noise."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    if kind == "cards":
        shot, depths, _ = photographs.expose(
            int(rng.integers(3)),
            seed,
            size=SIZE,
            travel=float(rng.uniform(0.08, 0.2)),
            noise=float(rng.uniform(0, 0.02)),
        )
        told = np.where(np.isfinite(depths), depths, 0).astype(np.float32)
        return Draw(f"{kind} {seed}", replace(shot, truth=replace(shot.truth, depth=told)))
    of = kind.split(maxsplit=1)[0]
    table = load_scene(of, size=SIZE).file.geometry
    scene = table.model_copy(update={"seed": seed}).build(SuggestedCamera(SIZE, 50.0), LIBRARY)
    rig = RigFigures(light=Light(float(rng.uniform(*_PHOTONS))), modulator=ModulatorFigures(masks=MASKS))
    if of == "corridor" and not kind.endswith("sideways"):
        travel = np.array([rng.uniform(0, 0.06), 0.0, rng.uniform(0.1, 0.4)]) / rig.exposure_s
        path = StageMove(tuple(travel.tolist()), 0.05, 4 / (3 * rig.exposure_s), scene.world_to_camera)
    else:
        angle = rng.uniform(0, 2 * np.pi)
        aim = (float(np.cos(angle)), float(np.sin(angle)), float(rng.uniform(-0.3, 0.3)))
        parallax = float(rng.uniform(*_PARALLAX_PX))
        path = stage_move_for_parallax(scene, parallax, rig.exposure_s, direction=aim, wobble_deg=0.05)
    masks = random_masks(MASKS, SIZE, 0.25, rng)
    shot = expose(scene, path, masks, rig, effects=(MotionBlur(), *sensor_effects(rig.sensor)), seed=seed)
    if kind.endswith("noisy"):
        shot = noisy(shot, float(np.exp(rng.uniform(*np.log(_NOISE)))), rng)
    return Draw(f"{kind} {seed}", staged(shot, _STAGE_OFF, rng) if kind.endswith("staged") else shot)


def light_fields(folder: Path) -> Iterator[Draw]:
    """Yield the path-traced light field's middle and another part of it, if the folder holds them."""
    if not (folder / "antinous.npz").is_file():
        return
    with np.load(folder / "antinous.npz") as held:
        masks, views = held["masks"].astype(np.float32), (held["truth"] / 255).astype(np.float32)
        matrix, poses = held["K"].astype(np.float64), held["world_to_camera"].astype(np.float64)
    with np.load(folder / "antinous_between.npz") as held:
        disparity = held["disparity"].astype(np.float64)
    measurement = np.einsum("nhw,nhwc->hwc", masks, views).astype(np.float32)
    depth = np.zeros(views.shape[:3], np.float32)
    depth[len(views) // 2] = _one_step_right(disparity, float(matrix[0, 0]))
    weights = np.ones(len(views), np.float32)
    whole = Shot(measurement, masks, weights, intrinsics=matrix, truth=Truth(views, poses, depth), name="light field")
    yield Draw("light field", middle(whole, SIZE).check())


def _one_step_right(disparity: np.ndarray, focal_px: float) -> F32:
    """Return the depth, [H, W], in steps of the rail, that the camera one step to the right sees; 0 where unknown."""
    found = np.zeros_like(disparity)
    for row, line in enumerate(disparity):
        order = np.argsort(line)  # the nearest last, so that it hides the others
        order = order[line[order] > 0]
        to = np.rint(order - line[order]).astype(int)
        inside = (to >= 0) & (to < len(line))
        found[row, to[inside]] = line[order[inside]]
    return np.where(found > 0, focal_px / np.where(found > 0, found, 1), 0).astype(np.float32)
