"""The light of a simulated rig: a scene rendered under the masks that the modulator twin really showed.

It joins the world of the twins (`world`) to the light path (`exposure`, `light_path`): the masks come from the
modulator's own pixels through the nominal registration, the poses from the stage twin's motion, the times from
the sensor twin's shutter. Not here: effects, rendering, protocols. `gs2ci.rig` and tests import this file.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci.core.progress import Silent
from gs2ci_sims.effects.base import Effect, Stage
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.exposure import collect_photons, read_out
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.scenes.base import Scene
from gs2ci_sims.sensor import Sensor
from gs2ci_sims.world import Exposure, MaskInterval

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U16 = NDArray[np.uint16]

CFA_CHANNELS = {"R": 0, "G": 1, "B": 2}


@dataclass(frozen=True)
class Registration:
    """Which modulator pixels a sensor pixel sees: a block of k × k, all blocks side by side.

    Args:
        superpixel: k.
        row: First modulator row seen by the sensor.
        column: First modulator column.
    """

    superpixel: int
    row: int
    column: int

    def on_sensor(self, interval: MaskInterval, height: int, width: int) -> F32:
        """Return a mask's transmissions at the sensor's pixels, [H, W] in [0, 1].

        Raises:
            InputError: The sensor looks beyond the modulator.
        """
        k = self.superpixel
        seen = interval.levels[self.row : self.row + k * height, self.column : self.column + k * width]
        if seen.shape != (k * height, k * width) or min(self.row, self.column) < 0:
            raise InputError(
                f"a sensor of {height} x {width} at {k} modulator pixels each, from row {self.row}, column "
                f"{self.column}, looks beyond the modulator's {list(interval.levels.shape)}",
                remedy="change [registration]",
            )
        blocks = seen.reshape(height, k, width, k).mean(axis=(1, 3), dtype=np.float32)
        return np.asarray(blocks / np.float32(interval.top), dtype=np.float32)


class _PathOfWorld:
    """The world's camera as the light path knows one."""

    def __init__(self, world_to_camera_at: Callable[[float], F64]) -> None:
        self._at = world_to_camera_at

    def world_to_camera(self, time_s: F64) -> F64:
        """Return poses, [T, 4, 4]."""
        return np.stack([self._at(float(t)) for t in np.asarray(time_s)])


class BenchLight:
    """A `gs2ci_sims.world.LightPath` that renders a scene.

    Args:
        scene: What the camera looks at; its suggested size is the sensor's.
        sensor: The sensor's data sheet.
        registration: Which modulator pixels a sensor pixel sees.
        full_scale_e_per_s: Electrons per second in a pixel that sees radiance 1 through an open mask.
        seed: Of all noise.
        cfa: Colour filter array ("RGGB"), or None for a mono sensor, which sees the mean of the three colours.
        noise: Whether the sensor's effects are on; off leaves quantisation alone.
        blur_samples: Slices of time per mask in which the scene is drawn.
        renderer: Draws it.
    """

    def __init__(
        self,
        scene: Scene,
        sensor: Sensor,
        registration: Registration,
        *,
        full_scale_e_per_s: float,
        seed: int = 0,
        cfa: str | None = None,
        noise: bool = True,
        blur_samples: int = 1,
        renderer: Renderer | None = None,
    ) -> None:
        self.scene = scene
        self.sensor = sensor
        self._registration = registration
        self._photons_per_s = full_scale_e_per_s / sensor.quantum_efficiency
        self._seed = seed
        self._cfa = cfa
        self._noise = noise
        self._blur: tuple[Effect, ...] = (MotionBlur(blur_samples),) if blur_samples > 1 else ()
        self._renderer = renderer or Renderer(supersampling=1)
        self._chains: dict[int, EffectChain] = {}

    def collect(self, exposure: Exposure) -> U16:
        """Return the sensor's pixels, [H, W] uint16.

        Raises:
            InputError: The sensor has another size than the scene's camera, or looks beyond the modulator.
        """
        height, width = exposure.height, exposure.width
        if (height, width) != self.scene.size:
            raise InputError(
                f"a sensor of {height} x {width} before a scene for {self.scene.size[0]} x {self.scene.size[1]}",
                remedy="set the same height and width in [sensor] and [world]",
            )
        sensor = self._sensor_of(exposure.bits)
        chain = self._chains.setdefault(exposure.bits, EffectChain((*self._blur, *self._effects(sensor)), self._seed))
        charge = self._mosaic(self._photons(exposure, chain))
        reading = read_out(charge[..., None], sensor, chain)[..., 0]
        return np.clip(np.rint(reading), 0, 2**exposure.bits - 1).astype(np.uint16)

    def truth(self, exposure: Exposure) -> tuple[F32, F64]:
        """Return what was really there at the centre of each mask: views [N, H, W, C] and poses [N, 4, 4]."""
        centres = [(interval.start_s + interval.end_s) / 2 for interval in exposure.masks]
        poses = np.stack([exposure.world_to_camera_at(t) for t in centres])
        views, _ = self._renderer.views(self.scene, poses)
        return (views if self._cfa else views.mean(axis=3, keepdims=True)), poses

    def _photons(self, exposure: Exposure, chain: EffectChain) -> F64:
        """Integrate over all masks on show, [H, W, 3]."""
        if not exposure.masks:
            return np.zeros((exposure.height, exposure.width, 3))
        masks = np.stack([self._registration.on_sensor(m, exposure.height, exposure.width) for m in exposure.masks])
        intervals = np.array([[[m.start_s, m.end_s]] for m in exposure.masks])
        return collect_photons(
            self.scene,
            _PathOfWorld(exposure.world_to_camera_at),
            masks,
            slices_s=chain.through(Stage.EXPOSURE, intervals),
            photons_per_s=self._photons_per_s,
            renderer=self._renderer,
            progress=Silent(),
        )

    def _mosaic(self, photons: F64) -> F64:
        """Put the sensor's filters over the pixels, [H, W]."""
        if self._cfa is None:
            return np.asarray(photons.mean(axis=2))
        mosaic = np.empty(photons.shape[:2])
        for i, letter in enumerate(self._cfa):
            row, column = divmod(i, 2)
            mosaic[row::2, column::2] = photons[row::2, column::2, CFA_CHANNELS[letter]]
        return mosaic

    def _sensor_of(self, bits: int) -> Sensor:
        """Return the data sheet at another bit depth: the same well over fewer or more steps."""
        steps = 2.0 ** (self.sensor.bits - bits)
        return replace(
            self.sensor,
            bits=bits,
            electrons_per_dn=self.sensor.electrons_per_dn * steps,
            black_level_dn=self.sensor.black_level_dn / steps,
        )

    def _effects(self, sensor: Sensor) -> tuple[Effect, ...]:
        effects = sensor.effects()
        return effects if self._noise else tuple(e for e in effects if e.name in ("full_well", "quantisation"))
