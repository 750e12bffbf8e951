"""Black level: the offset of all readings drifts off the data sheet's figure."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pydantic import FiniteFloat

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class BlackLevel(EffectRecord):
    """Shift all readings: the clamp's drift since the dark frames were taken.

    The offset mu_y.dark of EMVA Standard 1288, Release 3.1, section 2.1, is a figure of the data sheet
    (`Sensor.black_level_dn`) and always present; this effect is the difference of the true level from it. A shift down
    clips dark readings at 0 if the data sheet's level is too low for it.

    Args:
        shift_dn: True black level minus the data sheet's, DN.
    """

    stage: ClassVar[LightStage] = LightStage.READOUT
    cost_ns: ClassVar[float] = 2.0

    shift_dn: FiniteFloat

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """Exactly the shift."""
        shift = BoundStep("D", self.shift_dn, "DN", "shift of the black level")
        return Bound(abs(self.shift_dn), abs(self.shift_dn)).by("abs(D)", shift)

    def lowered_dn(self, rig: RigFigures) -> float:
        """The shift, if it is one down."""
        return max(-self.shift_dn, 0.0)

    def apply(self, signal: F64, rig: RigFigures, rng: np.random.Generator) -> F64:
        """Shift readings [H, W, C]."""
        return signal + self.shift_dn
