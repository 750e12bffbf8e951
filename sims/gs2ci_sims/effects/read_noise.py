"""Read noise: the amplifier's own contribution to every reading."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Bound, BoundStep, Previewed, Stage, gain_step
from gs2ci_sims.rig import Rig


@dataclass(frozen=True)
class ReadNoise:
    """Add normal noise, in electrons at the input: σ_d of EMVA Standard 1288, Release 3.1, section 2.2.

    Args:
        sigma_e: Standard deviation in electrons, at least 0.
    """

    name: ClassVar[str] = "read_noise"
    stage: ClassVar[Stage] = Stage.CHARGE
    cost_ns: ClassVar[float] = 20.0
    fixed_pattern: ClassVar[bool] = False

    sigma_e: float

    def __post_init__(self) -> None:
        if not (self.sigma_e >= 0 and np.isfinite(self.sigma_e)):
            raise InputError(f"read noise of {self.sigma_e} electrons", allowed="finite, 0 or more")

    def bound(self, scene: Previewed, rig: Rig) -> Bound:
        """σ_d times the gain K (EMVA 1288, eq. 10)."""
        sigma = BoundStep("sigma", self.sigma_e, "e", "standard deviation")
        bound = Bound(self.sigma_e * rig.dn_per_e, 6 * self.sigma_e * rig.dn_per_e, random=True)
        return bound.by("K * sigma", sigma, gain_step(rig))

    def apply(self, signal: F64, rig: Rig, rng: np.random.Generator) -> F64:
        """Add noise to electrons [H, W, C]; the sum may be negative, as a reading below black is."""
        return signal + self.sigma_e * rng.standard_normal(signal.shape)
