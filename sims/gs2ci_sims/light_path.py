"""The physical order of effects, and a separate random generator for each.

Here: `LIGHT_PATH`, from the scene to the file, and the chain of the effects that are switched on. Not here: the effects
themselves (`effects`), which ones a measurement needs (`planner`), the exposure itself (`exposure`).
"""

import zlib
from collections.abc import Collection, Sequence
from dataclasses import is_dataclass, replace
from functools import cache
from typing import Any, Final, TypeVar

import numpy as np

from gs2ci.core.arrays import F64, Rng
from gs2ci.core.errors import InputError
from gs2ci.core.plugins import PluginError, load, names
from gs2ci_sims.effects.base import Effect, LightStage, ViewEffect, having
from gs2ci_sims.effects.bayer_filter import BayerFilter
from gs2ci_sims.effects.charges import Blooming, DarkCurrent, FullWell, Persistence
from gs2ci_sims.effects.flicker import IlluminationDrift, IlluminationFlicker, LcosFlicker
from gs2ci_sims.effects.masks import FiniteContrast, MaskEdges, Misregistration
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.noises import Dsnu, HotPixels, Prnu, ReadNoise, RowNoise, ShotNoise
from gs2ci_sims.effects.object_motion import ObjectMotion
from gs2ci_sims.effects.photons import Dust, GhostReflection, ModulatorPsf
from gs2ci_sims.effects.readout import BlackLevel, GainNonlinearity, Quantisation
from gs2ci_sims.effects.stage import StageBacklash, StageRipple, StageVibration
from gs2ci_sims.effects.timing import ClockDrift, RollingShutter, TriggerTiming
from gs2ci_sims.effects.transitions import LcosResponse, MirrorTransition
from gs2ci_sims.effects.views import Defocus, LensDistortion, OpticsPsf, Vignetting
from gs2ci_sims.rig import RigFigures
from gs2ci_sims.sensor import SensorFigures

Signal = TypeVar("Signal")
EFFECT_GROUP: Final = "gs2ci.effects"

# The physical order: scene radiance -> optics -> modulator -> exposure integration -> sensor -> readout.
# Each effect acts at its own stage, stage after stage; within a stage, in the order given here. Effects that change the
# times at which light is collected come before effects that depend on these times.
LIGHT_PATH: Final[tuple[type[Effect], ...]] = (
    # scene radiance: positions and illumination
    StageRipple,
    StageBacklash,
    StageVibration,
    ObjectMotion,
    # when light is collected: the sensor's rows, the masks' clock, their switching, the sensor's window, the lamp
    RollingShutter,
    ClockDrift,
    MirrorTransition,
    LcosResponse,
    LcosFlicker,
    TriggerTiming,
    IlluminationFlicker,
    IlluminationDrift,
    # optics
    LensDistortion,
    Defocus,
    OpticsPsf,
    Vignetting,
    # modulator, as imaged onto the sensor
    MaskEdges,
    FiniteContrast,
    Misregistration,
    # exposure integration
    MotionBlur,
    # relay between modulator and sensor
    ModulatorPsf,
    GhostReflection,
    Dust,
    # sensor: photons to electrons, in the mean
    BayerFilter,
    Prnu,
    DarkCurrent,
    HotPixels,
    Persistence,
    # sensor: electrons counted, held and amplified
    ShotNoise,
    Blooming,
    FullWell,
    GainNonlinearity,
    Dsnu,
    ReadNoise,
    RowNoise,
    # readout: electrons to numbers
    BlackLevel,
    Quantisation,
)


def light_path(wanted: Collection[str]) -> tuple[type[Effect], ...]:
    """Return the kinds of effects in their physical order, those of plug-ins last within their stage.

    Args:
        wanted: Names of effects: no other plug-ins are imported, which may be broken.

    Raises:
        PluginError: One of these plug-ins is no effect.
    """
    path = list(LIGHT_PATH)
    for kind in (_plugged(name) for name in names(EFFECT_GROUP) if name in wanted):
        same = [place for place, other in enumerate(path) if other.stage is kind.stage]
        path.insert(same[-1] + 1 if same else len(path), kind)
    return tuple(path)


@cache
def _plugged(name: str) -> type[Effect]:
    kind: Any = load(EFFECT_GROUP, name)
    missing = [part for part in ("stage", "cost_ns", "fixed_pattern", "bound", "apply") if not hasattr(kind, part)]
    if not (isinstance(kind, type) and is_dataclass(kind)) or missing or getattr(kind, "name", "") != name:
        raise PluginError(
            f"the plug-in {name!r} is no effect" + (f": it has no {', no '.join(missing)}" if missing else ""),
            allowed="a frozen dataclass with what gs2ci_sims.effects.base.Effect asks for, and that name",
        )
    if name in {own.name for own in LIGHT_PATH}:
        raise PluginError(f"the plug-in {name!r} has the name of an effect of gs2ci", remedy="rename it")
    found: type[Effect] = kind  # type: ignore[assignment]
    return found


def generator(seed: int, name: str) -> Rng:
    """Get the generator that belongs to `name` alone under this seed.

    Generators depend on the name, not on the order: switching one effect on or off does not change others' draws.

    Raises:
        InputError: The seed is negative.
    """
    _refuse_negative(seed)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()),)))


def sensor_effects(sensor: SensorFigures) -> tuple[Effect, ...]:
    """List the effects that every sensor has, with this one's figures."""
    return (ShotNoise(), FullWell(sensor.full_well_e), ReadNoise(sensor.read_noise_e), Quantisation(sensor.bits))


def with_well_of(effects: Sequence[Effect], sensor: SensorFigures) -> SensorFigures:
    """Return the data sheet with the full well of an effect that stands for its own: others act and count up to it."""
    wells = [effect.capacity_e for effect in effects if isinstance(effect, FullWell)]
    return replace(sensor, full_well_e=wells[0]) if wells else sensor


def _refuse_negative(seed: int) -> None:
    if seed < 0:
        raise InputError(f"seed {seed}", allowed="0 or more")


class EffectChain:
    """The effects that are switched on, in their physical order, with their generators.

    Args:
        effects: Effects in any order; all others are off: they take no time and draw no random numbers.
        seed: Seed of the draws.
        rig: The rig whose figures the effects use.

    Raises:
        InputError: An effect occurs twice or has no place in `LIGHT_PATH`, or the seed is negative.
    """

    def __init__(self, effects: Sequence[Effect], seed: int, rig: RigFigures | None = None) -> None:
        names = [effect.name for effect in effects]
        order = LIGHT_PATH if all(type(effect) in LIGHT_PATH for effect in effects) else light_path(names)
        known = ", ".join(kind.name for kind in order)
        for effect in effects:
            if type(effect) not in order:
                raise InputError(f"effect {effect.name!r} has no place in the light path", allowed=known)
            if names.count(effect.name) > 1:
                raise InputError(f"effect {effect.name!r} is given twice", remedy="keep one of them")
        self.rig = rig or RigFigures()
        self.effects = tuple(sorted(effects, key=lambda effect: order.index(type(effect))))
        self.seed = seed
        _refuse_negative(seed)

    def at(self, stage: LightStage) -> tuple[Effect, ...]:
        """Get the effects of one stage, in order."""
        return tuple(effect for effect in self.effects if effect.stage is stage)

    def margin_px(self, size: tuple[int, int], intrinsics: F64) -> int:
        """Return how many pixels beyond the border of an image of this size the effects on views need."""
        looking = having(self.at(LightStage.RADIANCE), ViewEffect)
        return sum(effect.margin_px(self.rig, size, intrinsics) for effect in looking)

    def through(self, stage: LightStage, signal: Signal) -> Signal:
        """Pass the signal through the effects of one stage; without effects it is returned unchanged, bit for bit.

        A second call draws the same random numbers.
        """
        result: Any = signal
        for effect in self.at(stage):
            seed = self.rig.device_seed if effect.fixed_pattern else self.seed
            result = effect.apply(result, self.rig, generator(seed, effect.name))
        return result
