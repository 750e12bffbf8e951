"""The one physical order of effects, and the generators that keep them apart.

Here: `LIGHT_PATH`, from the scene to the file, and the chain of those effects that are switched on. Not here:
what an effect does (`effects`), which ones a measurement needs (`planner`), the exposure itself (`exposure`). For
this package.
"""

import zlib
from collections.abc import Sequence
from typing import Any, Final, TypeVar

import numpy as np

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Effect, Stage
from gs2ci_sims.effects.bayer_filter import BayerFilter
from gs2ci_sims.effects.black_level import BlackLevel
from gs2ci_sims.effects.blooming import Blooming
from gs2ci_sims.effects.dark_current import DarkCurrent
from gs2ci_sims.effects.dsnu import Dsnu
from gs2ci_sims.effects.full_well import FullWell
from gs2ci_sims.effects.gain_nonlinearity import GainNonlinearity
from gs2ci_sims.effects.hot_pixels import HotPixels
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.persistence import Persistence
from gs2ci_sims.effects.prnu import Prnu
from gs2ci_sims.effects.quantisation import Quantisation
from gs2ci_sims.effects.read_noise import ReadNoise
from gs2ci_sims.effects.rolling_shutter import RollingShutter
from gs2ci_sims.effects.row_noise import RowNoise
from gs2ci_sims.effects.shot_noise import ShotNoise
from gs2ci_sims.rig import Rig
from gs2ci_sims.sensor import Sensor

Signal = TypeVar("Signal")

# THE physical order: scene radiance -> optics -> modulator -> exposure integration -> sensor -> readout.
# Stages follow each other as `Stage` lists them; within a stage, light meets the effects in the order given here.
LIGHT_PATH: Final[tuple[type[Effect], ...]] = (
    # exposure: when light is collected
    MotionBlur,
    # sensor: when its rows are open
    RollingShutter,
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


def generator(seed: int, name: str) -> np.random.Generator:
    """Get the generator that belongs to `name` alone under this seed.

    Names, not turns, tell generators apart: switching one effect on or off changes no other's draws.

    Raises:
        InputError: The seed is negative.
    """
    if seed < 0:
        raise InputError(f"seed {seed}", allowed="0 or more")
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()),)))


def sensor_effects(sensor: Sensor) -> tuple[Effect, ...]:
    """List what every sensor does to the light, with this one's figures."""
    return (ShotNoise(), FullWell(sensor.full_well_e), ReadNoise(sensor.read_noise_e), Quantisation(sensor.bits))


class EffectChain:
    """The effects that are switched on, in their physical order, with their generators.

    Args:
        effects: In any order; those left out are off: they cost nothing and draw nothing.
        seed: Same seed, same draws.
        rig: Whose figures the effects work with.

    Raises:
        InputError: An effect occurs twice or has no place in `LIGHT_PATH`, or the seed is negative.
    """

    def __init__(self, effects: Sequence[Effect], seed: int, rig: Rig | None = None) -> None:
        known = ", ".join(kind.name for kind in LIGHT_PATH)
        names = [effect.name for effect in effects]
        for effect in effects:
            if type(effect) not in LIGHT_PATH:
                raise InputError(f"effect {effect.name!r} has no place in the light path", allowed=known)
            if names.count(effect.name) > 1:
                raise InputError(f"effect {effect.name!r} is given twice", remedy="keep one of them")
        self.rig = rig or Rig()
        self.effects = tuple(sorted(effects, key=lambda effect: LIGHT_PATH.index(type(effect))))
        self._generators = {
            effect.name: generator(self.rig.device_seed if effect.fixed_pattern else seed, effect.name)
            for effect in self.effects
        }

    def at(self, stage: Stage) -> tuple[Effect, ...]:
        """Get the effects of one stage, in order."""
        return tuple(effect for effect in self.effects if effect.stage is stage)

    def through(self, stage: Stage, signal: Signal) -> Signal:
        """Pass the signal through the effects of one stage; without any it comes back as it is, bit for bit."""
        result: Any = signal
        for effect in self.at(stage):
            result = effect.apply(result, self.rig, self._generators[effect.name])
        return result  # type: ignore[no-any-return]
