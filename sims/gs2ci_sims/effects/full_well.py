"""Full well: a pixel holds a limited number of electrons."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, enlarging_step, gain_step
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class FullWell(EffectRecord):
    """Clip each pixel's charge at its capacity; what is beyond is lost (no blooming).

    The saturation capacity µ_e.sat of EMVA Standard 1288, Release 3.1, section 2.4.

    Args:
        capacity_e: Electrons, more than 0.
    """

    stage: ClassVar[LightStage] = LightStage.CHARGE
    cost_ns: ClassVar[float] = 2.0

    capacity_e: Annotated[float, Field(gt=0)]

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The charge beyond the capacity, with six standard deviations of its noise."""
        _, rms_e, peak_e = scene.excess_e(self, self.capacity_e)
        dn = rig.dn_per_e * scene.gain_after(self)
        return Bound(dn * rms_e, dn * peak_e).by(
            "K * A * x",
            BoundStep("W", self.capacity_e, "e", "full well"),
            BoundStep("Q", float(scene.most_e.max()), "e", "upper bound of the charge of a pixel, without noise"),
            BoundStep("x", rms_e, "e", "charge beyond the well, with six sigma of its noise, rms over the pixels"),
            enlarging_step(scene, self),
            gain_step(rig),
        )

    def apply(self, signal: F64, rig: RigFigures, rng: np.random.Generator) -> F64:
        """Clip electrons [H, W, C]."""
        return np.minimum(signal, self.capacity_e)
