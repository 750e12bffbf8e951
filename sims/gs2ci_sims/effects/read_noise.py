"""Read noise: the amplifier's own contribution to every reading."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.charge_noise import ChargeNoise
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class ReadNoise(ChargeNoise):
    """Add normal noise, in electrons at the input: σ_d of EMVA Standard 1288, Release 3.1, section 2.2.

    Args:
        sigma_e: Standard deviation in electrons, at least 0.
    """

    cost_ns: ClassVar[float] = 20.0

    def apply(self, signal: F64, rig: RigFigures, rng: np.random.Generator) -> F64:
        """Add noise to electrons [H, W, C]; the sum may be negative, as a reading below black is."""
        return signal + self.sigma_e * rng.standard_normal(signal.shape)
