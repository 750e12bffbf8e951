"""Dark signal non-uniformity: every pixel has an offset of its own."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Bound, BoundStep, Previewed, Stage, gain_step
from gs2ci_sims.rig import Rig


@dataclass(frozen=True)
class Dsnu:
    """Add to each pixel an offset that is the same in every exposure of one device, normally distributed.

    DSNU_1288 of EMVA Standard 1288, Release 3.1, section 4, in electrons: the spatial standard deviation of the
    dark signal at short exposures. The offsets arise behind the photodiode, hence after counting and clipping; what
    grows with the exposure time is `dark_current`'s and `hot_pixels`'.

    Args:
        sigma_e: Standard deviation in electrons, at least 0.
    """

    name: ClassVar[str] = "dsnu"
    stage: ClassVar[Stage] = Stage.CHARGE
    cost_ns: ClassVar[float] = 20.0
    fixed_pattern: ClassVar[bool] = True

    sigma_e: float

    def __post_init__(self) -> None:
        if not (self.sigma_e >= 0 and np.isfinite(self.sigma_e)):
            raise InputError(f"DSNU of {self.sigma_e} electrons", allowed="finite, 0 or more")

    def bound(self, scene: Previewed, rig: Rig) -> Bound:
        """Standard deviation times the gain K, whatever the scene."""
        sigma = BoundStep("sigma", self.sigma_e, "e", "standard deviation")
        bound = Bound(self.sigma_e * rig.dn_per_e, 6 * self.sigma_e * rig.dn_per_e, random=True)
        return bound.by("K * sigma", sigma, gain_step(rig))

    def apply(self, signal: F64, rig: Rig, rng: np.random.Generator) -> F64:
        """Add the pattern to electrons [H, W, C]; the sum may be negative, as a reading below black is."""
        return signal + self.sigma_e * rng.standard_normal(signal.shape)
