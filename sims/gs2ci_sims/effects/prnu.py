"""Photo response non-uniformity: pixels convert different shares of their light into charge."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Bound, BoundStep, Previewed, Stage, ViewPreview, gain_step
from gs2ci_sims.rig import Rig


@dataclass(frozen=True)
class Prnu:
    """Multiply each pixel's charge by a factor of its own, normally distributed around 1.

    PRNU_1288 of EMVA Standard 1288, Release 3.1, section 4: the spatial standard deviation of the response,
    relative to its mean. The same pattern in every exposure of one device; it acts before electrons are counted,
    for it is a spread of quantum efficiencies.

    Args:
        spread: Relative standard deviation, 0 to 0.5 (0.01 is usual); no factor falls below 0.
    """

    name: ClassVar[str] = "prnu"
    stage: ClassVar[Stage] = Stage.CHARGE
    cost_ns: ClassVar[float] = 20.0
    fixed_pattern: ClassVar[bool] = True

    spread: float

    def __post_init__(self) -> None:
        if not 0 <= self.spread <= 0.5:
            raise InputError(f"PRNU of {self.spread}", allowed="0 to 0.5, a share of the signal")

    def bound(self, scene: Previewed, rig: Rig) -> Bound:
        """Spread times charge, times K; charge beyond the full well is clipped with and without the effect.

        A pixel above the well loses at most (1 - factor) of the well's charge to it, one below its share of its own.
        """
        most_e = np.minimum(scene.most_e, rig.sensor.full_well_e)
        rms_e = min(scene.charge_rms_e, float(np.sqrt(np.square(most_e).mean())))
        dn = self.spread * rig.dn_per_e
        return Bound(dn * rms_e, 6 * dn * float(most_e.max()), random=True).by(
            "K * s * Q",
            BoundStep("s", self.spread, "", "relative spread of the pixels' response"),
            BoundStep("Q", rms_e, "e", "charge, rms over the pixels"),
            gain_step(rig),
        )

    def brightest(self, scene: ViewPreview) -> float:
        """Six standard deviations above the mean."""
        return 1 + 6 * self.spread

    def apply(self, signal: F64, rig: Rig, rng: np.random.Generator) -> F64:
        """Scale mean electrons [H, W, C]."""
        return signal * np.maximum(1 + self.spread * rng.standard_normal(signal.shape), 0.0)
