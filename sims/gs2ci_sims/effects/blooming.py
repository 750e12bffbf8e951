"""Blooming: charge that a full pixel cannot hold spills along its column."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, enlarging_step, gain_step
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class Blooming(EffectRecord):
    """Let a share of each pixel's charge beyond the full well flow into its column, half up and half down.

    It fills every pixel that it reaches up to the well and flows on; what reaches the border is gone. The rest goes
    into the anti-blooming drain, hence share 1 is a sensor without one (Janesick, Scientific Charge-Coupled Devices
    (2001)). Acts before `full_well`, which clips what stays.

    Args:
        share: Share of the excess charge that spills, 0 to 1.
    """

    stage: ClassVar[LightStage] = LightStage.CHARGE
    cost_ns: ClassVar[float] = 40.0

    share: Annotated[float, Field(ge=0, le=1)]

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The total excess S spills into pixels that take at most the well's charge W each.

        The receivers' charges add up to S at most and none exceeds W, so their squares add up to W S at most, and to
        W^2 per pixel. Givers read W with and without it.
        """
        well_e, excess_e = rig.sensor.full_well_e, scene.excess_e(self, rig.sensor.full_well_e)[0]
        spilled_e = self.share * excess_e
        rms_e = np.sqrt(min(spilled_e, well_e) * well_e)
        peak_e = min(spilled_e * scene.charge_e.size, well_e)
        dn = rig.dn_per_e * scene.gain_after(self)
        return Bound(dn * float(rms_e), dn * peak_e).by(
            "K * A * sqrt(min(x, W) * W)",
            BoundStep("s", self.share, "", "share of the excess charge that spills"),
            BoundStep("W", rig.sensor.full_well_e, "e", "full well"),
            BoundStep("e", excess_e, "e", "charge beyond the well, with six sigma of its noise, mean over the pixels"),
            BoundStep("x", spilled_e, "e", "of it spilled, per pixel", "s * e"),
            enlarging_step(scene, self),
            gain_step(rig),
        )

    def apply(self, signal: F64, rig: RigFigures, rng: np.random.Generator) -> F64:
        """Spill electrons [H, W, C] along axis 0."""
        well_e = rig.sensor.full_well_e
        spilled = self.share * np.maximum(signal - well_e, 0.0)
        level = signal - spilled
        for rows in (range(len(signal)), range(len(signal) - 1, -1, -1)):
            flow = np.zeros(signal.shape[1:])
            for row in rows:
                taken = np.minimum(flow, np.maximum(well_e - level[row], 0.0))
                level[row] += taken
                flow += 0.5 * spilled[row] - taken
        return level
