"""One coded exposure: light is integrated over time behind changing masks, counted, and read out.

Here: the integral over time, the read-out, and `expose`, which is both. Not here: effects and their order
(`light_path`), which of them are needed (`planner`), poses (`path`), masks (`masks`). For commands, twins and tests.

The forward model is the bench's, not the solver's: photons arrive at a rate while the camera moves, through
whatever mask is on show at that moment, and one sensor collects them all. Nothing is imported from the solver.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci.core.progress import Progress, Silent
from gs2ci.core.records import Shot, Truth
from gs2ci_sims.effects.base import Effect, Stage
from gs2ci_sims.effects.bayer_filter import BayerFilter
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.path import CameraPath
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import Rig
from gs2ci_sims.scenes.base import Scene
from gs2ci_sims.signals import Slices, View, nominal_slices

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


def expose(
    scene: Scene,
    path: CameraPath,
    masks: F32,
    rig: Rig,
    *,
    effects: Sequence[Effect],
    seed: int,
    renderer: Renderer | None = None,
    progress: Progress | None = None,
) -> Shot:
    """Expose the sensor once to the scene behind the masks.

    Args:
        scene: What is seen; its camera is the sensor's.
        path: Where the camera is at any time; time 0 is the middle of the exposure.
        masks: Transmissions at the sensor's pixels, [N, H, W] in [0, 1], in the order shown.
        rig: The figures of light, modulator, timing and sensor.
        effects: Those that are simulated; `planner.plan` chooses them.
        seed: Of all draws.
        renderer: Draws the views.
        progress: Hears about each mask.

    Returns:
        The shot, in units of one view's full scale, with true views and poses at the centre of each mask's
        interval and with the pixels that may be clipped marked.

    Raises:
        InputError: Masks do not fit the scene or the rig.
    """
    renderer, progress = renderer or Renderer(), progress or Silent()
    _check(scene, masks, rig)
    chain = EffectChain(effects, seed, rig)
    path = chain.through(Stage.MOTION, path)
    intervals = rig.timing.intervals_s(len(masks))
    slices = chain.through(Stage.TIME, nominal_slices(intervals))
    shown = chain.through(Stage.MASKS, masks)
    photons = collect_photons(scene, path, shown, slices=slices, chain=chain, renderer=renderer, progress=progress)
    reading = read_out(photons, chain)
    poses = path.world_to_camera(intervals.mean(axis=1))
    views, coverage = renderer.views(scene, poses)
    sensor = rig.sensor
    full_scale_e = rig.full_scale_e or 1.0
    return Shot(
        measurement=(sensor.electrons_from_dn(reading) / full_scale_e).astype(np.float32),
        masks=np.clip(shown, 0, 1).astype(np.float32),
        weights=(slices.weights_s().sum(axis=0) / rig.timing.interval_s).astype(np.float32),
        intrinsics=scene.intrinsics,
        truth=Truth(views=views, world_to_camera=poses),
        saturated=np.any(reading >= sensor.saturation_dn, axis=2),
        cfa=next((effect.pattern for effect in chain.effects if isinstance(effect, BayerFilter)), None),
        name=scene.name,
        provenance={
            "source": "simulated exposure (gs2ci_sims)",
            "seed": seed,
            "effects": [f"{effect}" for effect in chain.effects],
            "rig": f"{rig}",
            "path": f"{path}",
            "sub_exposures": len(slices.at_s),
            "covered_share": float((coverage >= 0.99).mean(axis=(1, 2)).min()),
        },
    ).check()


def collect_photons(
    scene: Scene,
    path: CameraPath,
    masks: NDArray[Any],
    *,
    slices: Slices,
    chain: EffectChain,
    renderer: Renderer,
    progress: Progress,
) -> F64:
    """Integrate light over time, behind each mask while it is on show.

    Args:
        scene: What is seen.
        path: Where the camera is at any time.
        masks: [N, H, W].
        slices: When light is collected, and through which masks.
        chain: Effects; those of the stages SCENE, RADIANCE and PHOTONS act here.
        renderer: Draws the view of each slice.
        progress: Hears about each slice.

    Returns:
        Mean number of photons in each pixel, [H, W, 3]: Σ mask x radiance x rate x time.
    """
    progress.stage("exposure", len(slices.at_s))
    photons = np.zeros((*scene.size, 3))
    weights = slices.weights_s() * chain.rig.photons_per_s
    for s, at_s in enumerate(slices.at_s):
        radiance, _ = renderer.views(scene, path.world_to_camera(at_s[None]))
        view = chain.through(Stage.RADIANCE, View(radiance[0].astype(np.float64), scene.intrinsics))
        open_share = np.tensordot(weights[s], masks, axes=1)
        if slices.rows is not None:
            open_share = open_share * slices.rows[s][:, None]
        photons += open_share[..., None] * view.radiance
        progress.step(s + 1)
    return chain.through(Stage.PHOTONS, photons)


def read_out(photons: F64, chain: EffectChain) -> F64:
    """Count the photons and convert them to readings, [H, W, C] DN, through the sensor's effects in the chain."""
    sensor = chain.rig.sensor
    charge = chain.through(Stage.CHARGE, sensor.quantum_efficiency * photons)
    return chain.through(Stage.READOUT, sensor.dn_from_electrons(charge))


def _check(scene: Scene, masks: F32, rig: Rig) -> None:
    if masks.ndim != 3 or masks.shape[1:] != scene.size:
        raise InputError(
            f"masks of shape {list(masks.shape)} on a sensor of {list(scene.size)}",
            allowed=f"[N, {scene.size[0]}, {scene.size[1]}]",
        )
    if len(masks) != rig.modulator.masks:
        raise InputError(
            f"{len(masks)} masks on a rig that shows {rig.modulator.masks}",
            remedy="set [modulator] masks of the rig to the number of masks",
        )
