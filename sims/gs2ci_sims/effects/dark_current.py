"""Dark current: electrons freed by heat, in proportion to the exposure."""

from dataclasses import dataclass
from typing import Annotated, ClassVar, Final

import numpy as np
from pydantic import Field, FiniteFloat

from gs2ci.core.arrays import F64
from gs2ci.core.config import NotNegative
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, enlarging_step, gain_step
from gs2ci_sims.effects.counts import most_counted_e
from gs2ci_sims.rig import RigFigures

# The temperature for which data sheets state the current.
REFERENCE_C: Final = 25.0


@dataclass(frozen=True)
class DarkCurrent(EffectRecord):
    """Add the mean charge that collects in the dark during the whole exposure, gaps between masks included.

    It grows linearly with time and exponentially with temperature: mu_I(T) = mu_I.ref 2^((T - T_ref) / T_d) (EMVA
    Standard 1288, Release 3.1, section 3). Its electrons are counted with the others: with `shot_noise` on, their
    variance is their mean, as the standard has it.

    Args:
        current_e_per_s: mu_I.ref, electrons per pixel and second at 25 degrees Celsius, at least 0.
        temperature_c: Temperature of the sensor, degrees Celsius, -100 to 100.
        doubling_k: T_d, the warming that doubles the current, more than 0 (silicon: 6 to 10 K).
    """

    stage: ClassVar[LightStage] = LightStage.CHARGE
    cost_ns: ClassVar[float] = 2.0

    current_e_per_s: NotNegative
    temperature_c: Annotated[float, Field(ge=-100, le=100)] = REFERENCE_C
    doubling_k: Annotated[FiniteFloat, Field(ge=1)] = 8.0

    def collected_e(self, exposure_s: float) -> float:
        """Get the mean electrons that one pixel collects in the dark."""
        return float(self.current_e_per_s * 2 ** ((self.temperature_c - REFERENCE_C) / self.doubling_k) * exposure_s)

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The collected charge D, which is exact, and the shot noise that comes with it: sqrt(D^2 + D), times K A.

        Charge beyond the full well is lost.
        """
        dark_e = min(self.collected_e(rig.exposure_s), rig.sensor.full_well_e)
        dn = rig.dn_per_e * scene.gain_after(self)
        return Bound(dn * float(np.sqrt(dark_e**2 + dark_e)), dn * float(most_counted_e(dark_e))).by(
            "K * A * sqrt(D**2 + D)",
            BoundStep("I", self.current_e_per_s, "e/s", "dark current at 25 C"),
            BoundStep("C", self.temperature_c, "C", "temperature of the sensor"),
            BoundStep("h", self.doubling_k, "K", "warming that doubles the current"),
            BoundStep("t", rig.exposure_s, "s", "exposure"),
            BoundStep("W", rig.sensor.full_well_e, "e", "full well"),
            BoundStep("D", dark_e, "e", "charge collected in the dark", "min(I * 2 ** ((C - 25) / h) * t, W)"),
            enlarging_step(scene, self),
            gain_step(rig),
        )

    def added_e(self, rig: RigFigures, size: tuple[int, int]) -> tuple[float, float]:
        """Return the collected charge, the same in every pixel."""
        return (self.collected_e(rig.exposure_s),) * 2

    def apply(self, signal: F64, rig: RigFigures, rng: np.random.Generator) -> F64:
        """Add to mean electrons [H, W, C]."""
        return signal + self.collected_e(rig.exposure_s)
