"""Dark signal non-uniformity: every pixel has an offset of its own."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.charge_noise import ChargeNoise
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class Dsnu(ChargeNoise):
    """Add to each pixel an offset that is the same in every exposure of one device, normally distributed.

    DSNU_1288 of EMVA Standard 1288, Release 3.1, section 4, in electrons: the spatial standard deviation of the
    dark signal at short exposures. The offsets arise behind the photodiode, hence after counting and clipping; what
    grows with the exposure time is `dark_current`'s and `hot_pixels`'.

    Args:
        sigma_e: Standard deviation in electrons, at least 0.
    """

    cost_ns: ClassVar[float] = 20.0
    fixed_pattern: ClassVar[bool] = True

    def apply(self, signal: F64, rig: RigFigures, rng: np.random.Generator) -> F64:
        """Add the pattern to electrons [H, W, C]; the sum may be negative, as a reading below black is."""
        return signal + self.sigma_e * rng.standard_normal(signal.shape)
