"""Row noise: all pixels of a row share one draw, since they are read out at the same moment."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.charge_noise import ChargeNoise
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class RowNoise(ChargeNoise):
    """Add one normal number to each row, new in every exposure, in electrons at the input.

    Correlated temporal noise of supply and reference voltages, visible where it exceeds a tenth of the pixel noise
    (Nakamura, Image Sensors and Signal Processing for Digital Still Cameras (2006), section 3.3).

    Args:
        sigma_e: Standard deviation in electrons, at least 0.
    """

    cost_ns: ClassVar[float] = 2.0

    def apply(self, signal: F64, rig: RigFigures, rng: np.random.Generator) -> F64:
        """Add to electrons [H, W, C], the same over W and C."""
        return signal + self.sigma_e * rng.standard_normal((len(signal), 1, 1))
