"""Time and memory of a simulated exposure at full size: 1080 x 1920 px behind 16 masks.

    python -m tests.benchmarks simulation_size

The scene "planes" before a bench with a lens, a DMD of finite contrast and soft edges and a sensor's noises, at rest
and with a parallax of 3 px. `GS2CI_SIZE` ("1080x1920") and `GS2CI_MASKS` (16) ask for others. Times are the
processor's, all threads together; memory is the largest that the process ever held, of a process of its own per row.
"""

import multiprocessing
import os
import resource
import time

import numpy as np

from gs2ci_sims.effects.masks import FiniteContrast, MaskEdges
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.views import OpticsPsf, Vignetting
from gs2ci_sims.light_path import sensor_effects
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import StageMove, stage_move_for_parallax
from gs2ci_sims.planner import plan
from gs2ci_sims.rig import Light, ModulatorFigures, RigFigures, Timing
from gs2ci_sims.scenes.files import load_scene
from gs2ci_sims.simulation_plan import PlanChoice, SimulationTask
from tests.exposing import expose

HEIGHT, WIDTH = (int(side) for side in os.environ.get("GS2CI_SIZE", "1080x1920").split("x"))
MASKS = int(os.environ.get("GS2CI_MASKS", "16"))
PARALLAXES_PX = (0.0, 3.0)
KILOBYTES_PER_GIB = 1024**2


def _measured(parallax_px: float) -> str:
    began_s = time.process_time()
    scene = load_scene("planes", size=(HEIGHT, WIDTH)).scene
    rig = RigFigures(light=Light(2000.0), modulator=ModulatorFigures(masks=MASKS), timing=Timing(0.01))
    path = stage_move_for_parallax(scene, parallax_px, rig.exposure_s) if parallax_px else StageMove((0.0, 0.0, 0.0))
    masks = random_masks(MASKS, scene.size, 0.25, np.random.default_rng(0))
    effects = (
        MotionBlur(),
        *sensor_effects(rig.sensor),
        OpticsPsf(0.4),
        Vignetting(),
        FiniteContrast(),
        MaskEdges(),
    )
    made_s = time.process_time()
    decided = plan(SimulationTask(scene, path, masks, rig, effects), PlanChoice(1.0))
    planned_s = time.process_time()
    shot = expose(scene, path, masks, rig, effects=decided.effects, seed=0)
    exposed_s = time.process_time()
    assert np.isfinite(shot.measurement).all()
    most_gib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / KILOBYTES_PER_GIB
    return (
        f"| {parallax_px:g} px | {len(scene.gaussians)} | {decided.views} | {made_s - began_s:.1f} "
        f"| {planned_s - made_s:.1f} | {exposed_s - planned_s:.1f} | {most_gib:.2f} |"
    )


def run() -> None:
    """Print a row per parallax."""
    print(f"{HEIGHT} x {WIDTH} px, {MASKS} masks, tolerance 1 DN")
    print("| parallax | Gaussians | views | scene, s | plan, s | exposure, s | memory, GiB |")
    print("|---|---|---|---|---|---|---|")
    for parallax_px in PARALLAXES_PX:
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            print(pool.apply(_measured, (parallax_px,)), flush=True)
