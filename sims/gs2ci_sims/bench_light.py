"""The light of a simulated rig: a scene rendered under the masks that the modulator twin really showed.

It joins the world of the twins (`world`) to the light path (`exposure`, `light_path`): the masks come from the
modulator's own pixels through the nominal registration, the poses from the stage twin's motion, the times from
the sensor twin's shutter. Not here: effects, rendering, protocols. `gs2ci.rig` and tests import this file.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci.core.records import CfaPattern
from gs2ci_sims.effects.base import Effect
from gs2ci_sims.effects.bayer_filter import BayerFilter
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.exposure import integrate, read_out
from gs2ci_sims.light_path import EffectChain, sensor_effects
from gs2ci_sims.planner import DEFAULT_TOLERANCE_DN, Plan, plan
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import Light, Modulator, Rig, Timing
from gs2ci_sims.scenes.base import Scene
from gs2ci_sims.sensor import Sensor
from gs2ci_sims.signals import Slices
from gs2ci_sims.world import Exposure, MaskInterval

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U16 = NDArray[np.uint16]

# Moments at which the camera's pose is asked for during an exposure; between them it is interpolated.
POSES_FOLLOWED: Final = 257


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


@dataclass(frozen=True)
class _FollowedPath:
    """The world's camera during one exposure, as the light path knows one: poses at `times_s`, linear between."""

    times_s: F64
    poses: F64

    def world_to_camera(self, time_s: F64) -> F64:
        """Return poses, [T, 4, 4]; before the exposure its first, after it its last."""
        entries = self.poses.reshape(len(self.times_s), 16)
        between = [np.interp(time_s, self.times_s, column) for column in entries.T]
        return np.stack(between, axis=-1).reshape(-1, 4, 4)

    @property
    def moves(self) -> bool:
        """Get whether the camera moves at all."""
        return bool(np.ptp(self.poses, axis=0).any())


class BenchLight:
    """A `gs2ci_sims.world.LightPath` that renders a scene, as exactly as a plan says (`planner`).

    Args:
        scene: What the camera looks at; its suggested size is the sensor's.
        sensor: The sensor's data sheet.
        registration: Which modulator pixels a sensor pixel sees.
        full_scale_e_per_s: Electrons per second in a pixel that sees radiance 1 through an open mask.
        seed: Of all noise.
        cfa: Colour filter array ("RGGB"), or None for a mono sensor, which sees the mean of the three colours.
        noise: Whether the sensor's noises are on; off leaves full well and quantisation.
        effects: What else the rig has.
        tolerance_dn: Of the plans.
        renderer: Draws the scene.
    """

    def __init__(
        self,
        scene: Scene,
        sensor: Sensor,
        registration: Registration,
        *,
        full_scale_e_per_s: float,
        seed: int = 0,
        cfa: CfaPattern | None = None,
        noise: bool = True,
        effects: Sequence[Effect] = (),
        tolerance_dn: float = DEFAULT_TOLERANCE_DN,
        renderer: Renderer | None = None,
    ) -> None:
        self.scene = scene
        self.sensor = sensor
        self.plans: dict[int, Plan] = {}
        """What was simulated in each exposure, by its index."""
        self._registration = registration
        self._photons_per_s = full_scale_e_per_s / sensor.quantum_efficiency
        self._seed = seed
        self._cfa = cfa
        self._noise = noise
        self._extra = tuple(effects)
        self._tolerance_dn = tolerance_dn
        self._renderer = renderer or Renderer(supersampling=1)
        self._plans_at_rest: dict[tuple[Rig, bytes], Plan] = {}

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
        # Every exposure draws anew.
        seed = int(np.random.SeedSequence((self._seed, exposure.index)).generate_state(1)[0])
        rig = self._rig(exposure)
        effects = self._effects(rig.sensor)
        if exposure.masks:
            photons, effects = self._photons(exposure, rig, effects, seed)
        else:
            photons = np.zeros((height, width, 3))
        if self._cfa is None:
            photons = photons.mean(axis=2, keepdims=True)
        reading = read_out(photons, EffectChain(effects, seed, rig))[..., 0]
        return np.clip(np.rint(reading), 0, 2**exposure.bits - 1).astype(np.uint16)

    def truth(self, exposure: Exposure) -> tuple[F32, F64]:
        """Return what was really there at the centre of each mask: views [N, H, W, C] and poses [N, 4, 4]."""
        centres = [(interval.start_s + interval.end_s) / 2 for interval in exposure.masks]
        poses = np.stack([exposure.world_to_camera_at(t) for t in centres])
        views, _ = self._renderer.views(self.scene, poses)
        return (views if self._cfa else views.mean(axis=3, keepdims=True)), poses

    def _photons(
        self, exposure: Exposure, rig: Rig, effects: tuple[Effect, ...], seed: int
    ) -> tuple[F64, tuple[Effect, ...]]:
        """Integrate over all masks on show, [H, W, 3], and say which effects are simulated."""
        masks = np.stack([self._registration.on_sensor(m, exposure.height, exposure.width) for m in exposure.masks])
        middle_s = 0.5 * (exposure.masks[0].start_s + exposure.masks[-1].end_s)
        times_s = np.linspace(exposure.start_s, exposure.end_s, POSES_FOLLOWED)
        poses = np.stack([exposure.world_to_camera_at(float(t)) for t in times_s])
        path = _FollowedPath(times_s - middle_s, poses)
        start_s, stop_s = np.array([[m.start_s, m.end_s] for m in exposure.masks]).T - middle_s
        slices = Slices(start_s, stop_s, np.eye(len(masks)), np.arange(len(masks)), start_s)
        decided = self._plan(path, masks, rig, effects, slices, seed)
        self.plans[exposure.index] = decided
        chain = EffectChain(decided.effects, seed, rig)
        light = integrate(self.scene, path, masks, chain, slices=slices, renderer=self._renderer)
        return light.photons, decided.effects

    def _plan(
        self, path: _FollowedPath, masks: F32, rig: Rig, effects: tuple[Effect, ...], slices: Slices, seed: int
    ) -> Plan:
        """Plan the exposure; before a camera at rest, exposures of one kind share their plan."""
        kind = (rig, path.poses[0].tobytes() + np.round(masks.mean(axis=(1, 2)), 1).tobytes())
        if not path.moves and kind in self._plans_at_rest:
            return self._plans_at_rest[kind]
        decided = plan(
            self.scene,
            path,
            masks,
            rig,
            effects,
            tolerance_dn=self._tolerance_dn,
            seed=seed,
            slices=slices,
            renderer=self._renderer,
        )
        if not path.moves:
            self._plans_at_rest[kind] = decided
        return decided

    def _rig(self, exposure: Exposure) -> Rig:
        """Return the figures of the rig for one exposure: its masks' mean time on show and the gaps between them."""
        count = max(len(exposure.masks), 1)
        shown_s = sum(m.end_s - m.start_s for m in exposure.masks) or exposure.end_s - exposure.start_s
        span_s = exposure.masks[-1].end_s - exposure.masks[0].start_s if exposure.masks else shown_s
        # Clock times carry rounding errors; a nanosecond is no gap.
        interval_s = round(shown_s / count, 9) or shown_s / count
        gap_s = max(round((span_s - shown_s) / max(count - 1, 1), 9), 0.0)
        return Rig(
            light=Light(self._photons_per_s * interval_s),
            modulator=Modulator(masks=count),
            timing=Timing(interval_s, gap_s),
            sensor=self._sensor_of(exposure.bits),
            device_seed=self._seed,
        )

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
        effects = sensor_effects(sensor)
        if not self._noise:
            effects = tuple(effect for effect in effects if effect.name in ("full_well", "quantisation"))
        filters = (BayerFilter(self._cfa),) if self._cfa else ()
        return (MotionBlur(), *filters, *effects, *self._extra)
