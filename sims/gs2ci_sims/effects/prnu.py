"""Photo response non-uniformity: pixels convert different shares of their light into charge."""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.base import (
    Bound,
    BoundStep,
    EffectRecord,
    LightStage,
    Previewed,
    ViewPreview,
    enlarging_step,
    gain_step,
)
from gs2ci_sims.effects.counts import SIGMAS, most_in_sum
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class Prnu(EffectRecord):
    """Multiply each pixel's charge by a factor of its own, normally distributed around 1.

    PRNU_1288 of EMVA Standard 1288, Release 3.1, section 4: the spatial standard deviation of the response,
    relative to its mean. The same pattern in every exposure of one device; it acts before electrons are counted,
    for it is a spread of quantum efficiencies.

    Args:
        spread: Relative standard deviation, 0 to 0.5 (0.01 is usual); no factor falls below 0.
    """

    stage: ClassVar[LightStage] = LightStage.CHARGE
    cost_ns: ClassVar[float] = 20.0
    fixed_pattern: ClassVar[bool] = True

    spread: Annotated[float, Field(ge=0, le=0.5)]

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """Spread times charge, times K; one device in 1e7 exceeds it, even if masks leave light in a single pixel.

        The mean square over devices is v. The limit for one device is that of a sum of squared normal numbers
        (`counts.most_in_sum`) with weights of sum v, the largest of them b; and each factor is within six standard
        deviations. Charge beyond the full well is clipped with and without the effect: a pixel above the well loses
        at most (1 - factor) of the well's charge to it, one below its share of its own.
        """
        after = scene.gain_after(self)
        most_e = np.minimum(scene.most_e / after, rig.sensor.full_well_e)
        rms_e, top_e = min(scene.charge_rms_e / after, float(np.sqrt(np.square(most_e).mean()))), float(most_e.max())
        dn, pixels = self.spread * rig.dn_per_e * after, int(np.prod(scene.scene.size))
        mean, largest = (dn * rms_e) ** 2, (dn * top_e) ** 2 / pixels
        limit = math.sqrt(min(most_in_sum(mean, 2 * mean * largest, 2 * largest), SIGMAS**2 * mean))
        return Bound(limit, SIGMAS * dn * top_e, random=True).by(
            "sqrt(min(v + 6 * sqrt(2 * v * b) + 36 * b, 36 * v))",
            BoundStep("s", self.spread, "", "relative spread of the pixels' response"),
            BoundStep("Q", rms_e, "e", "charge, rms over the pixels"),
            BoundStep("T", top_e, "e", "upper bound of the charge of a pixel"),
            BoundStep("n", pixels, "", "pixels"),
            enlarging_step(scene, self),
            gain_step(rig),
            BoundStep("v", mean, "DN^2", "mean square over the pixels and over devices", "(K * A * s * Q)**2"),
            BoundStep(
                "b", largest, "DN^2", "what one pixel adds to it at most, mean over devices", "(K * A * s * T)**2 / n"
            ),
        )

    def brightest(self, scene: ViewPreview) -> float:
        """Six standard deviations above the mean."""
        return 1 + 6 * self.spread

    def apply(self, signal: F64, rig: RigFigures, rng: np.random.Generator) -> F64:
        """Scale mean electrons [H, W, C]."""
        return signal * np.maximum(1 + self.spread * rng.standard_normal(signal.shape), 0.0)
