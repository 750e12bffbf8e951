"""`gs2ci demo`: a simulated exposure of a real scene, and what can be recovered from it.

Here: which scene, camera move, masks and light the demonstration takes. Not here: the simulation (`gs2ci_sims`),
the reconstruction (`gs2ci.commands.reconstruct`). Only `gs2ci.cli` imports this file.
"""

from pathlib import Path
from typing import Annotated, Final

import tyro

from gs2ci.commands import reconstruct
from gs2ci.commands.display import open_display
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot
from gs2ci.core.storage import write_shots
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.exposure import expose
from gs2ci_sims.light_path import generator, sensor_effects
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import stage_move_for_parallax
from gs2ci_sims.planner import plan
from gs2ci_sims.rig import Light, Modulator, Rig
from gs2ci_sims.scenes.rgbd import motorcycle
from gs2ci_sims.sensor import Sensor

# About two masks of eight are open at a pixel, so four times full scale still fits the sensor's well.
OPEN_SHARE: Final = 0.25
FULL_WELLS_PER_VIEW: Final = 0.25


def run(
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("runs/demo"),
    *,
    views: int = 8,
    height: int = 272,
    width: int = 400,
    parallax_px: float = 12.0,
    seed: int = 0,
) -> Path:
    """Expose a simulated sensor once to a motorcycle behind changing masks, and recover what it saw.

    Args:
        output: The folder for the shot file and the run folder; an earlier demonstration there is replaced.
        views: Masks during the exposure.
        height: Of the measurement, in pixels.
        width: Of the measurement, in pixels.
        parallax_px: How far near and far shift against each other during the exposure.
        seed: Of masks and noise.

    Returns:
        The run folder.
    """
    with open_display() as display:
        shot = simulate(views=views, size=(height, width), parallax_px=parallax_px, seed=seed, progress=display)
    output.mkdir(parents=True, exist_ok=True)
    measured = write_shots(output / "shot.h5", [shot])
    return reconstruct.run(measured, output / "run", overwrite=True)


def simulate(*, views: int, size: tuple[int, int], parallax_px: float, seed: int, progress: Progress) -> Shot:
    """Expose an IMX255-class sensor to the motorcycle during one small stage move."""
    progress.stage("scene")
    scene = motorcycle(size)
    progress.step(1, gaussians=len(scene.gaussians))
    sensor = Sensor()
    rig = Rig(
        light=Light(FULL_WELLS_PER_VIEW * sensor.full_well_e / sensor.quantum_efficiency),
        modulator=Modulator(masks=views, open_share=OPEN_SHARE),
        sensor=sensor,
    )
    path = stage_move_for_parallax(scene, parallax_px, rig.exposure_s)
    masks = random_masks(views, size, OPEN_SHARE, generator(seed, "masks"))
    decided = plan(scene, path, masks, rig, (MotionBlur(), *sensor_effects(sensor)), seed=seed)
    progress.say(decided.summary())
    return expose(scene, path, masks, rig, effects=decided.effects, plan=decided.record(), seed=seed, progress=progress)
