"""The base of noises that add to the charge: a standard deviation in electrons, and the bound that follows from it."""

from dataclasses import dataclass
from typing import ClassVar

from gs2ci.core.config import NotNegative
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, gain_step
from gs2ci_sims.effects.counts import SIGMAS
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class ChargeNoise(EffectRecord):
    """Normal numbers that an effect adds to the electrons, drawn in its own way."""

    stage: ClassVar[LightStage] = LightStage.CHARGE

    sigma_e: NotNegative

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """Standard deviation times the gain K (EMVA 1288, eq. 10), whatever the scene."""
        sigma = BoundStep("sigma", self.sigma_e, "e", "standard deviation")
        bound = Bound(self.sigma_e * rig.dn_per_e, self.lowered_dn(rig), random=True)
        return bound.by("K * sigma", sigma, gain_step(rig))

    def lowered_dn(self, rig: RigFigures) -> float:
        """Six standard deviations."""
        return SIGMAS * self.sigma_e * rig.dn_per_e
