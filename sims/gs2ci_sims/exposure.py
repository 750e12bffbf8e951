"""One coded exposure: light is integrated over time behind changing masks, counted, and read out.

Here: the timing, the integral over time, the read-out, and `expose`, which is all three. Not here: effects and
their order (`light_path`), poses (`path`), masks (`masks`). For commands, twins and tests.

The forward model is the bench's, not the solver's: photons arrive at a rate while the camera moves, through
whatever mask is on show at that moment, and one sensor collects them all. Nothing is imported from the solver.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci.core.progress import Progress, Silent
from gs2ci.core.records import Shot, Truth
from gs2ci_sims.effects.base import Effect, Stage
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.path import CameraPath
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.scenes.base import Scene
from gs2ci_sims.sensor import Sensor

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Timing:
    """When the masks are on show: equal intervals, back to back or with dark gaps, centred on time 0.

    Args:
        interval_s: Time that each mask is exposed, more than 0.
        dark_s: Gap between two masks, at least 0; the camera moves on during it.
    """

    interval_s: float = 0.1
    dark_s: float = 0.0

    def __post_init__(self) -> None:
        if not self.interval_s > 0 or self.dark_s < 0:
            raise InputError(
                f"mask intervals of {self.interval_s} s with gaps of {self.dark_s} s",
                allowed="interval_s > 0, dark_s >= 0",
            )

    def intervals_s(self, count: int) -> F64:
        """Get start and stop of each of `count` intervals, [N, 2]."""
        starts = (np.arange(count) - 0.5 * count) * (self.interval_s + self.dark_s) + 0.5 * self.dark_s
        return np.stack([starts, starts + self.interval_s], axis=1)

    def duration_s(self, count: int) -> float:
        """Get the time from the start of the first interval to the stop of the last."""
        return count * self.interval_s + (count - 1) * self.dark_s


def expose(
    scene: Scene,
    path: CameraPath,
    masks: F32,
    sensor: Sensor,
    *,
    full_scale_photons: float,
    effects: Sequence[Effect],
    seed: int,
    timing: Timing | None = None,
    renderer: Renderer | None = None,
    progress: Progress | None = None,
) -> Shot:
    """Expose the sensor once to the scene behind the masks.

    Args:
        scene: What is seen; its camera is the sensor's.
        path: Where the camera is at any time; time 0 is the middle of the exposure.
        masks: Transmissions at the sensor's pixels, [N, H, W] in [0, 1], in the order shown.
        sensor: Converts photons to readings.
        full_scale_photons: Photons that a pixel receives from radiance 1 through an open mask during one interval.
        effects: Those that are switched on; `sensor.effects()` and a `MotionBlur` for the real thing.
        seed: Of all draws.
        timing: When the masks are on show.
        renderer: Draws the views.
        progress: Hears about each mask.

    Returns:
        The shot, in units of one view's full scale, with true views and poses at the centre of each mask's
        interval and with the pixels that may be clipped marked.

    Raises:
        InputError: Masks and scene differ in size, or the light level is not positive and finite.
    """
    timing, renderer, progress = timing or Timing(), renderer or Renderer(), progress or Silent()
    _check(scene, masks, full_scale_photons)
    chain = EffectChain(effects, seed)
    intervals = timing.intervals_s(len(masks))
    slices = chain.through(Stage.EXPOSURE, intervals[:, None, :])
    photons = collect_photons(
        scene,
        path,
        masks,
        slices_s=slices,
        photons_per_s=full_scale_photons / timing.interval_s,
        renderer=renderer,
        progress=progress,
    )
    reading = read_out(photons, sensor, chain)
    full_scale_e = sensor.quantum_efficiency * full_scale_photons
    poses = path.world_to_camera(intervals.mean(axis=1))
    views, coverage = renderer.views(scene, poses)
    return Shot(
        measurement=(sensor.electrons_from_dn(reading) / full_scale_e).astype(np.float32),
        masks=masks,
        weights=((slices[..., 1] - slices[..., 0]).sum(axis=1) / timing.interval_s).astype(np.float32),
        intrinsics=scene.intrinsics,
        truth=Truth(views=views, world_to_camera=poses),
        saturated=np.any(reading >= sensor.saturation_dn, axis=2),
        name=scene.name,
        provenance={
            "source": "simulated exposure (gs2ci_sims)",
            "seed": seed,
            "effects": [f"{effect}" for effect in chain.effects],
            "sensor": f"{sensor}",
            "timing": f"{timing}",
            "path": f"{path}",
            "full_scale_photons": full_scale_photons,
            "sub_exposures": int(slices.shape[1]),
            "covered_share": float((coverage >= 0.99).mean(axis=(1, 2)).min()),
        },
    ).check()


def collect_photons(
    scene: Scene,
    path: CameraPath,
    masks: F32,
    *,
    slices_s: F64,
    photons_per_s: float,
    renderer: Renderer,
    progress: Progress,
) -> F64:
    """Integrate light over time, behind each mask while it is on show.

    Args:
        scene: What is seen.
        path: Where the camera is at any time.
        masks: [N, H, W].
        slices_s: Start and stop of the slices in which each mask is exposed, [N, S, 2].
        photons_per_s: Rate of photons in a pixel at radiance 1 through an open mask.
        renderer: Draws the view at the middle of each slice.
        progress: Hears about each mask.

    Returns:
        Mean number of photons in each pixel, [H, W, 3]: Σ mask x radiance x rate x time.
    """
    progress.stage("exposure", len(masks))
    photons = np.zeros((*scene.size, 3))
    for n, (mask, parts) in enumerate(zip(masks, slices_s, strict=True)):
        radiance, _ = renderer.views(scene, path.world_to_camera(parts.mean(axis=1)))
        time_s = parts[:, 1] - parts[:, 0]
        photons += mask[..., None] * np.tensordot(photons_per_s * time_s, radiance.astype(np.float64), axes=1)
        progress.step(n + 1)
    return photons


def read_out(photons: F64, sensor: Sensor, chain: EffectChain) -> F64:
    """Count the photons and convert them to readings, [H, W, C] DN, through the sensor's effects in the chain."""
    charge = chain.through(Stage.CHARGE, sensor.quantum_efficiency * photons)
    return chain.through(Stage.READOUT, sensor.dn_from_electrons(charge))


def _check(scene: Scene, masks: F32, full_scale_photons: float) -> None:
    if masks.ndim != 3 or masks.shape[1:] != scene.size:
        raise InputError(
            f"masks of shape {list(masks.shape)} on a sensor of {list(scene.size)}",
            allowed=f"[N, {scene.size[0]}, {scene.size[1]}]",
        )
    if not (full_scale_photons > 0 and np.isfinite(full_scale_photons)):
        raise InputError(f"a light level of {full_scale_photons} photons", allowed="more than 0, finite")
