"""Illumination flicker: the light of lamps on the mains oscillates at twice its frequency."""

from dataclasses import dataclass

import numpy as np

from gs2ci.core.config import Positive
from gs2ci_sims.effects.base import BoundStep
from gs2ci_sims.effects.periodic import Oscillation
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class IlluminationFlicker(Oscillation):
    """Multiply the light by 1 + depth cos(2 pi 2 mains t + phase); the phase is random: nothing is locked to the mains.

    `depth` is percent flicker / 100, (max - min) / (max + min) (IEEE 1789-2015, section 3).

    Args:
        depth: 0 to 1.
        mains_hz: Frequency of the supply; light oscillates at twice that.
    """

    mains_hz: Positive = 50.0

    def frequency(self) -> tuple[BoundStep, ...]:
        """Return the mains' frequency and the light's."""
        mains = BoundStep("mains", self.mains_hz, "Hz", "frequency of the mains")
        return mains, BoundStep("f", 2 * self.mains_hz, "Hz", "frequency of the light", "2 * mains")

    def phase(self, rig: RigFigures, rng: np.random.Generator) -> float:
        """Draw the phase."""
        return float(rng.uniform(0, 2 * np.pi))
