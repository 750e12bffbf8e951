"""Reconstruction of scenes not drawn by the solver's own renderer: ray-traced Gaussians, and textured meshes.

    python -m tests.benchmarks own_model_class

Each scene is exposed behind 8 random masks at 64 x 96 px, once as the solver's rasteriser draws it (2 x 2 samples),
once ray by ray in float64 (4 x 4 rays), meshes by rays alone, with the sensor's noises, and reconstructed. It prints
the PSNR of the views delivered and of the scene alone against the true ones, the rank correlation of depth with the
truth, and the median error of depth after scaling; means over seeds of masks and noise.

| variable | what it sets | default |
|---|---|---|
| `GS2CI_SEEDS` | how many seeds | 1 |
| `GS2CI_PRESET` | the preset | standard |
"""

import os
from statistics import fmean

import numpy as np

from gs2ci.core.records import Shot
from gs2ci.evaluate.depth import DepthErrors, depth_errors
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.presets.named import preset
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.exact import ExactRenderer
from gs2ci_sims.light_path import sensor_effects
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import stage_move_for_parallax
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import Light, ModulatorFigures, RigFigures, Timing
from gs2ci_sims.scenes.files import load_scene
from tests.exposing import expose

SIZE = (64, 96)
MASKS = 8
PARALLAX_PX = 4.0
SEEDS = int(os.environ.get("GS2CI_SEEDS", "1"))
PRESET = os.environ.get("GS2CI_PRESET", "standard")
SCENES = ("planes", "ball", "boxes", "thicket")
MESHES = ("blocks", "glossy")
RENDERERS = {"rasteriser": Renderer(), "rays": ExactRenderer()}
RAYS_THROUGH_MESHES = Renderer(supersampling=4)


def taken(name: str, renderer: Renderer, seed: int, size: tuple[int, int] = SIZE) -> Shot:
    """Expose a scene of the simulator behind random masks, drawn by a renderer, with the sensor's noises."""
    scene = load_scene(name, size=size).scene
    rig = RigFigures(light=Light(2000.0), modulator=ModulatorFigures(masks=MASKS), timing=Timing(0.02))
    path = stage_move_for_parallax(scene, PARALLAX_PX, rig.exposure_s, wobble_deg=0.02)
    masks = random_masks(MASKS, size, 0.25, np.random.default_rng(seed))
    effects = (MotionBlur(1), *sensor_effects(rig.sensor))
    return expose(scene, path, masks, rig, effects=effects, seed=seed, renderer=renderer)


def _row(name: str, how: str, renderer: Renderer) -> str:
    views: list[float] = []
    scenes: list[float] = []
    depths: list[DepthErrors] = []
    for seed in range(SEEDS):
        shot = taken(name, renderer, seed)
        assert shot.truth.views is not None
        found = reconstruct(shot, preset(PRESET)).result  # type: ignore[arg-type]
        for quality, shown in ((views, found.views), (scenes, found.scene_views)):
            quality.append(fmean(psnr_per_view(np.clip(shown, 0, 1), np.clip(shot.truth.views, 0, 1))))
        if found.depth is not None and shot.truth.depth is not None:
            told = depth_errors(found.depth, shot.truth.depth)
            depths += [] if told is None else [told]
    ranks = [one.rank for one in depths if one.rank is not None]
    rank = f"{fmean(ranks):.3f}" if ranks else "-"
    off = f"{fmean(one.median_rel for one in depths):.1%}" if depths else "-"
    return f"| {name} | {how} | {fmean(views):.2f} | {fmean(scenes):.2f} | {rank} | {off} | {len(depths)} of {SEEDS} |"


def run() -> None:
    """Print a row per scene and renderer."""
    print("| scene | drawn by | views, dB | scene, dB | rank of depth | median error of depth | depth found |")
    print("|---|---|---|---|---|---|---|")
    for name in SCENES:
        for how, renderer in RENDERERS.items():
            print(_row(name, how, renderer), flush=True)
    for name in MESHES:
        print(_row(name, "rays through a mesh", RAYS_THROUGH_MESHES), flush=True)
