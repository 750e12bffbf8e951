"""The one physical order of effects, and the generators that keep them apart.

Here: `LIGHT_PATH`, from the scene to the file, and the chain of those effects that are switched on. Not here:
what an effect does (`effects`), which ones a measurement needs (`planner`), the exposure itself (`exposure`). For
this package.
"""

import zlib
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Effect, Stage
from gs2ci_sims.effects.full_well import FullWell
from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.quantisation import Quantisation
from gs2ci_sims.effects.read_noise import ReadNoise
from gs2ci_sims.effects.shot_noise import ShotNoise

F64 = NDArray[np.float64]

# Light arrives over time, is counted, fills the well, is amplified, is digitised.
LIGHT_PATH: Final[tuple[type[Effect], ...]] = (MotionBlur, ShotNoise, FullWell, ReadNoise, Quantisation)


def generator(seed: int, name: str) -> np.random.Generator:
    """Get the generator that belongs to `name` alone under this seed.

    Names, not turns, tell generators apart: switching one effect on or off changes no other's draws.

    Raises:
        InputError: The seed is negative.
    """
    if seed < 0:
        raise InputError(f"seed {seed}", allowed="0 or more")
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()),)))


class EffectChain:
    """The effects that are switched on, in their physical order, with their generators.

    Args:
        effects: In any order; those left out are off: they cost nothing and draw nothing.
        seed: Same seed, same draws.

    Raises:
        InputError: An effect occurs twice or has no place in `LIGHT_PATH`, or the seed is negative.
    """

    def __init__(self, effects: Sequence[Effect], seed: int) -> None:
        known = ", ".join(kind.name for kind in LIGHT_PATH)
        names = [effect.name for effect in effects]
        for effect in effects:
            if type(effect) not in LIGHT_PATH:
                raise InputError(f"effect {effect.name!r} has no place in the light path", allowed=known)
            if names.count(effect.name) > 1:
                raise InputError(f"effect {effect.name!r} is given twice", remedy="keep one of them")
        self.effects = tuple(sorted(effects, key=lambda effect: LIGHT_PATH.index(type(effect))))
        self._generators = {effect.name: generator(seed, effect.name) for effect in self.effects}

    def through(self, stage: Stage, signal: F64) -> F64:
        """Pass the signal through the effects of one stage; without any it comes back as it is."""
        for effect in self.effects:
            if effect.stage is stage:
                signal = effect.apply(signal, self._generators[effect.name])
        return signal
