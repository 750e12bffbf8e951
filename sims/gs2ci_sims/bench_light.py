"""The light of a simulated rig: a scene rendered under the masks that the modulator twin really showed.

It connects the world of the twins (`world`) with the light path (`exposure`, `light_path`): the masks come from the
modulator's own pixels through the registration, the poses from the stage twin's motion, the times from the sensor
twin's shutter. For calibration, other targets can be put before the camera (`look_at_*`). For a scene the planner
chooses which effects are simulated; for such targets all are. Not here: effects, rendering, protocols.
"""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64, U16
from gs2ci.core.errors import InputError
from gs2ci.core.records import CfaPattern
from gs2ci_sims.effects.base import Effect, LightStage
from gs2ci_sims.effects.bayer_filter import BayerFilter
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.views import Defocus, LensDistortion
from gs2ci_sims.exposure import Studio, calibrated_masks, integrate, lens_of, read_out
from gs2ci_sims.light_path import EffectChain, generator, sensor_effects, with_well_of
from gs2ci_sims.path import CameraPath
from gs2ci_sims.planner import plan
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.registration import MaskAlignment
from gs2ci_sims.rig import Light, ModulatorFigures, RigFigures, Timing
from gs2ci_sims.scene import Scene
from gs2ci_sims.sensor import SensorFigures
from gs2ci_sims.signals import Slices
from gs2ci_sims.simulation_plan import DEFAULT_TOLERANCE_DN, Plan, PlanChoice, SimulationTask
from gs2ci_sims.targets import BoardPlane, EvenLight, board_scene
from gs2ci_sims.world import BOOT_S, Exposure

# Number of moments of an exposure at which the camera's pose is read; between them it is interpolated.
POSES_FOLLOWED: Final = 257

# A power of two, so that a level of 1 is a step exactly; a level above a step by less is rounding.
LAMP_STEP: Final = 2.0**-6
ROUNDING: Final = 1e-9

PLANS_KEPT = 16
"""Number of plans kept for exposures with a camera at rest; the oldest is deleted first."""


@dataclass(frozen=True)
class _FollowedPath:
    """The world's camera during one exposure, as a camera path: poses at `times_s`, linear in between."""

    times_s: F64
    poses: F64

    def world_to_camera(self, time_s: F64) -> F64:
        """Return poses, [T, 4, 4]; before the exposure the first pose, after it the last."""
        entries = self.poses.reshape(len(self.times_s), 16)
        between = [np.interp(time_s, self.times_s, column) for column in entries.T]
        return np.stack(between, axis=-1).reshape(-1, 4, 4)

    @property
    def moves(self) -> bool:
        """Get whether the camera moves at all."""
        return bool(np.ptp(self.poses, axis=0).any())


@dataclass(frozen=True)
class _Sight:
    """The target before the camera.

    Args:
        scene: The scene; for a calibration target only its camera is used.
        renderer: Renders it.
        target: Whether it is for calibration: then all effects are simulated, and nothing moves except the stage.
        lit: Whether light comes in; it does not with the lens cap on.
    """

    scene: Scene
    renderer: Renderer
    target: bool = True
    lit: bool = True


class BenchLight:
    """A `gs2ci_sims.world.LightPath` that renders a scene, as exactly as a plan says (`planner`).

    Args:
        scene: The scene before the camera; its suggested size is the sensor's.
        sensor: The sensor's data sheet.
        registration: The true map between sensor pixels and modulator pixels.
        full_scale_e_per_s: Electrons per second in a pixel that sees radiance 1 through an open mask.
        seed: Seed of all noise.
        cfa: Colour filter array ("RGGB"), or None for a mono sensor, which sees the mean of the three colours.
        noise: Whether the sensor's noises are on; off leaves full well and quantisation.
        effects: Further effects of the rig; an effect of a kind that every sensor has (shot noise, read noise, ...)
            replaces that one.
        lamp_drift_per_min: Relative change of the light per minute of the world's time.
        tolerance_dn: Tolerance of the plans.
        renderer: Renders the scene.
    """

    def __init__(
        self,
        scene: Scene,
        sensor: SensorFigures,
        registration: MaskAlignment,
        *,
        full_scale_e_per_s: float,
        seed: int = 0,
        cfa: CfaPattern | None = None,
        noise: bool = True,
        effects: Sequence[Effect] = (),
        lamp_drift_per_min: float = 0.0,
        tolerance_dn: float = DEFAULT_TOLERANCE_DN,
        renderer: Renderer | None = None,
    ) -> None:
        self.scene = scene
        self.sensor = with_well_of(effects, sensor)
        self.plans: dict[int, Plan] = {}
        """The plan of each exposure, by its index."""
        self.registration = registration
        self._photons_per_s = full_scale_e_per_s / sensor.quantum_efficiency
        self._seed = seed
        self._cfa = cfa
        self._noise = noise
        self._extra = tuple(effects)
        self._lamp_drift_per_min = lamp_drift_per_min
        self._tolerance_dn = tolerance_dn
        self._renderer = renderer or Renderer(supersampling=1)
        self._plans_at_rest: dict[bytes, Plan] = {}
        self._sight = _Sight(scene, self._renderer, target=False)

    def look_at_scene(self) -> None:
        """Put the scene before the camera, as at the start."""
        self._sight = _Sight(self.scene, self._renderer, target=False)

    def look_at_nothing(self) -> None:
        """Put the lens cap on."""
        self._sight = replace(self._sight, target=True, lit=False)

    def look_at_even_light(self, radiance: float) -> None:
        """Put an evenly lit field before the camera; 1 is the white of a scene."""
        self._sight = _Sight(self.scene, EvenLight(radiance=radiance))

    def look_at_board(self, plane: BoardPlane, index: int, *, fixed: bool = False) -> None:
        """Put a ChArUco board before the camera, in the pose of an index, or fixed on a stand."""
        self._sight = _Sight(*board_scene(self.scene, plane, index, self._seed, self.lens, fixed=fixed))

    def collect(self, exposure: Exposure) -> U16:
        """Return the sensor's pixels, [H, W] uint16.

        Raises:
            InputError: The sensor's size differs from that of the scene's camera, or it sees beyond the modulator.
            NumericsError: An effect gave readings that are not finite.
        """
        height, width = exposure.height, exposure.width
        if (height, width) != self.scene.size:
            raise InputError(
                f"a sensor of {height} x {width} before a scene for {self.scene.size[0]} x {self.scene.size[1]}",
                remedy="set the same height and width in [sensor] and [world], and leave binning out of "
                "[sensor.features]: a simulated scene is of single pixels",
            )
        seed = self._seed_of(exposure)
        rig = self._rig(exposure)
        effects = self._effects(rig.sensor)
        if exposure.masks and self._sight.lit:
            photons, effects = self._photons(exposure, rig, effects, seed)
            lamp, planned = self._lamp(exposure)
            photons = photons * (lamp / (planned or 1.0))
        else:
            photons = np.zeros((height, width, 3))
        if self._cfa is None:
            photons = photons.mean(axis=2, keepdims=True)
        reading = read_out(photons, EffectChain(effects, seed, rig))[..., 0]
        return np.clip(np.rint(reading), 0, 2**exposure.bits - 1).astype(np.uint16)

    def truth(self, exposure: Exposure) -> tuple[F32, F64]:
        """Return the truth at the central time of each mask: views [N, H, W, C] and poses [N, 4, 4].

        Camera and objects are where the exposure's effects moved them; views are sharp, with the lens's distortion.
        """
        studio, path, centres_s = self._studio(exposure)
        views = np.stack([studio.sharp_view(float(time_s)) for time_s in centres_s]).astype(np.float32)
        return (views if self._cfa else views.mean(axis=3, keepdims=True)), path.world_to_camera(centres_s)

    def true_depth(self, exposure: Exposure) -> F32:
        """Return the true depth at the central time of each mask, [N, H, W]; 0 at pixels without a surface."""
        studio, _, centres_s = self._studio(exposure)
        return studio.depths(centres_s)

    def _studio(self, exposure: Exposure) -> tuple[Studio, CameraPath, F64]:
        """Return the target as the exposure's motions show it, the camera's path, and the middles of the masks, [N].

        Times are in seconds from the middle of the exposure.
        """
        rig, (path, middle_s) = self._rig(exposure), self._followed(exposure)
        planned = self.plans.get(exposure.index)
        effects = self._effects(rig.sensor) if planned is None else planned.effects
        # Calibration targets include the distortion themselves.
        lens = () if self._sight.target else (LensDistortion,)
        moving = [e for e in effects if e.stage in (LightStage.MOTION, LightStage.SCENE) or isinstance(e, lens)]
        chain = EffectChain(moving, self._seed_of(exposure), rig)
        moved = chain.through(LightStage.MOTION, path)
        centres_s = np.array([0.5 * (mask.start_s + mask.end_s) for mask in exposure.masks]) - middle_s
        return Studio(self._sight.scene, moved, chain, self._sight.renderer), moved, centres_s

    def true_masks(self, levels: NDArray[np.integer], top: int = 1) -> F32:
        """Return patterns as a noiseless calibration on a flat field measures them, [N, H, W] in [0, 1].

        Args:
            levels: Levels on the modulator's own pixels, [N, Hm, Wm].
            top: The level of a fully open pixel.
        """
        height, width = self.scene.size
        seen = np.stack([self.registration.seen(pattern, top, height, width) for pattern in levels])
        chain = EffectChain(self._extra, self._seed, self.nominal_rig(self.sensor.bits))
        return calibrated_masks(chain.through(LightStage.MASKS, seen), chain)

    def nominal_rig(self, bits: int) -> RigFigures:
        """Return the rig's figures for one open mask over a second, at a bit depth of the converter."""
        return RigFigures(
            light=Light(self._photons_per_s),
            modulator=ModulatorFigures(masks=1),
            timing=Timing(1.0),
            sensor=self._sensor_of(bits),
            device_seed=self._seed,
        )

    def fixed_pattern(self, effect: Effect, signal: F64, rig: RigFigures) -> F64:
        """Pass a signal [H, W, C] through one effect with this device's own pattern."""
        return np.asarray(effect.apply(signal, rig, generator(rig.device_seed, effect.name)))

    @property
    def lens(self) -> LensDistortion | None:
        """Get the lens, if it distorts."""
        return lens_of(self._extra)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Get the rig's effects in addition to those of every sensor."""
        return self._extra

    def foresee(self, exposure: Exposure) -> Plan:
        """Plan an exposure to the scene without exposing.

        Raises:
            InputError: The sensor sees beyond the modulator.
        """
        rig = self._rig(exposure)
        path, masks, slices = self._laid_out(exposure)
        return self._plan(path, masks, rig, self._effects(rig.sensor), slices, self._seed_of(exposure))

    def _seed_of(self, exposure: Exposure) -> int:
        """Return the seed of an exposure's own draws."""
        return int(np.random.SeedSequence((self._seed, exposure.index)).generate_state(1)[0])

    def _laid_out(self, exposure: Exposure) -> tuple[_FollowedPath, F32, Slices]:
        """Return the camera's path during an exposure, its masks on the sensor, [N, H, W], and when each is shown."""
        masks = np.stack([self.registration.on_sensor(m, exposure.height, exposure.width) for m in exposure.masks])
        path, middle_s = self._followed(exposure)
        start_s, stop_s = np.array([[m.start_s, m.end_s] for m in exposure.masks]).T - middle_s
        return path, masks, Slices(start_s, stop_s, np.eye(len(masks)), np.arange(len(masks)), start_s)

    def _followed(self, exposure: Exposure) -> tuple[_FollowedPath, float]:
        """Return the camera's path, before effects, and the world's time at the path's time 0, in mid-exposure."""
        middle_s = 0.5 * (exposure.masks[0].start_s + exposure.masks[-1].end_s)
        # Even light looks the same from every pose.
        followed = 2 if isinstance(self._sight.renderer, EvenLight) else POSES_FOLLOWED
        times_s = np.linspace(exposure.start_s, exposure.end_s, followed)
        poses = np.stack([exposure.world_to_camera_at(float(t)) for t in times_s])
        return _FollowedPath(times_s - middle_s, poses), middle_s

    def _photons(
        self, exposure: Exposure, rig: RigFigures, effects: tuple[Effect, ...], seed: int
    ) -> tuple[F64, tuple[Effect, ...]]:
        """Integrate over all masks shown, [H, W, 3]; return also which effects are simulated."""
        path, masks, slices = self._laid_out(exposure)
        if self._sight.target:
            # Targets include distortion themselves: even light has none, a board is distorted before it is sampled.
            absent = MotionBlur | Defocus | LensDistortion
            chosen = tuple(effect for effect in effects if not isinstance(effect, absent))
        else:
            decided = self._plan(path, masks, rig, effects, slices, seed)
            self.plans[exposure.index], chosen = decided, decided.effects
        chain = EffectChain(chosen, seed, rig)
        sight = self._sight
        return integrate(sight.scene, path, masks, chain, slices=slices, renderer=sight.renderer), chosen

    def _plan(
        self, path: _FollowedPath, masks: F32, rig: RigFigures, effects: tuple[Effect, ...], slices: Slices, seed: int
    ) -> Plan:
        """Plan the exposure; with a camera at rest, exposures with the same masks and times share a plan.

        Bounds depend on every pixel of the masks, so the key includes all inputs of the plan. An effect that shakes
        the camera draws new numbers in each exposure, so with such an effect each exposure has a plan of its own.
        """
        steady = not path.moves and not any(effect.stage is LightStage.MOTION for effect in effects)
        key = _digest(rig, path.poses[0], masks, slices.start_s, slices.stop_s)
        if steady and key in self._plans_at_rest:
            return self._plans_at_rest[key]
        decided = plan(
            SimulationTask(self.scene, path, masks, rig, effects, seed, slices),
            PlanChoice(self._tolerance_dn),
            renderer=self._renderer,
        )
        if steady:
            if len(self._plans_at_rest) >= PLANS_KEPT:
                self._plans_at_rest.pop(next(iter(self._plans_at_rest)))
            self._plans_at_rest[key] = decided
        return decided

    def _lamp(self, exposure: Exposure) -> tuple[float, float]:
        """Return the lamp's level at an exposure, 1 at first, and the next step of `LAMP_STEP`, which plans count on.

        So a plan holds for the light of its exposure, and exposures under nearly the same light share it.
        """
        minutes = (exposure.start_s - BOOT_S) / 60
        lamp = max(1 + self._lamp_drift_per_min * minutes, 0.0)
        return lamp, math.ceil(lamp / LAMP_STEP - ROUNDING) * LAMP_STEP

    def _rig(self, exposure: Exposure) -> RigFigures:
        """Return the figures of the rig for one exposure: the lamp, the mean time of its masks and the gaps."""
        count = max(len(exposure.masks), 1)
        shown_s = sum(m.end_s - m.start_s for m in exposure.masks) or exposure.end_s - exposure.start_s
        span_s = exposure.masks[-1].end_s - exposure.masks[0].start_s if exposure.masks else shown_s
        # Clock times have rounding errors; a nanosecond is no gap.
        interval_s = round(shown_s / count, 9) or shown_s / count
        gap_s = max(round((span_s - shown_s) / max(count - 1, 1), 9), 0.0)
        return RigFigures(
            light=Light(self._photons_per_s * self._lamp(exposure)[1] * interval_s),
            modulator=ModulatorFigures(masks=count),
            timing=Timing(interval_s, gap_s),
            sensor=self._sensor_of(exposure.bits),
            device_seed=self._seed,
        )

    def _sensor_of(self, bits: int) -> SensorFigures:
        """Return the data sheet at another bit depth: the same full well with fewer or more steps."""
        steps = 2.0 ** (self.sensor.bits - bits)
        return replace(
            self.sensor,
            bits=bits,
            electrons_per_dn=self.sensor.electrons_per_dn * steps,
            black_level_dn=self.sensor.black_level_dn / steps,
        )

    def _effects(self, sensor: SensorFigures) -> tuple[Effect, ...]:
        given = {effect.name for effect in self._extra}
        effects = tuple(effect for effect in sensor_effects(sensor) if effect.name not in given)
        if not self._noise:
            effects = tuple(effect for effect in effects if effect.name in ("full_well", "quantisation"))
        filters = (BayerFilter(self._cfa),) if self._cfa else ()
        return (MotionBlur(), *filters, *effects, *self._extra)


def _digest(rig: RigFigures, *arrays: NDArray[Any]) -> bytes:
    """Return a hash of all figures and arrays; the effects are always the same objects."""
    digest = hashlib.blake2b(repr(rig).encode())
    for array in arrays:
        digest.update(f"{array.shape}{array.dtype}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.digest()
