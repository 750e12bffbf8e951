"""Row noise: all pixels of a row share one draw, since they are read out at the same moment."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Bound, BoundStep, Previewed, Stage, gain_step
from gs2ci_sims.rig import Rig


@dataclass(frozen=True)
class RowNoise:
    """Add one normal number to each row, new in every exposure, in electrons at the input.

    Correlated temporal noise of supply and reference voltages, visible where it exceeds a tenth of the pixel noise
    (Nakamura, Image Sensors and Signal Processing for Digital Still Cameras (2006), section 3.3).

    Args:
        sigma_e: Standard deviation in electrons, at least 0.
    """

    name: ClassVar[str] = "row_noise"
    stage: ClassVar[Stage] = Stage.CHARGE
    cost_ns: ClassVar[float] = 2.0
    fixed_pattern: ClassVar[bool] = False

    sigma_e: float

    def __post_init__(self) -> None:
        if not (self.sigma_e >= 0 and np.isfinite(self.sigma_e)):
            raise InputError(f"row noise of {self.sigma_e} electrons", allowed="finite, 0 or more")

    def bound(self, scene: Previewed, rig: Rig) -> Bound:
        """Standard deviation times the gain K, whatever the scene."""
        sigma = BoundStep("sigma", self.sigma_e, "e", "standard deviation")
        bound = Bound(self.sigma_e * rig.dn_per_e, 6 * self.sigma_e * rig.dn_per_e, random=True)
        return bound.by("K * sigma", sigma, gain_step(rig))

    def apply(self, signal: F64, rig: Rig, rng: np.random.Generator) -> F64:
        """Add to electrons [H, W, C], the same over W and C."""
        return signal + self.sigma_e * rng.standard_normal((len(signal), 1, 1))
