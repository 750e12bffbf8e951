"""LCoS flicker: pulse-coded drive makes a panel's reflectance ripple."""

from dataclasses import dataclass

import numpy as np

from gs2ci.core.config import Positive
from gs2ci_sims.effects.base import BoundStep
from gs2ci_sims.effects.periodic import Oscillation
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class LcosFlicker(Oscillation):
    """Multiply all transmissions by 1 + depth cos(2 pi drive t), synchronous with the masks: they share a clock.

    The molecules follow the pulses of a digital drive (Hermerschmidt et al., Proc. SPIE 7723 (2010), on phase
    flicker); behind a polariser that is a ripple of the transmission.

    Args:
        depth: 0 to 1.
        drive_hz: Frequency of the pulse sequence.
    """

    drive_hz: Positive = 300.0

    def frequency(self) -> tuple[BoundStep, ...]:
        """Return the drive's frequency."""
        return (BoundStep("f", self.drive_hz, "Hz", "frequency of the drive"),)

    def phase(self, rig: RigFigures, rng: np.random.Generator) -> float:
        """Return the phase, which is 0 when the first mask is switched on."""
        begin = -0.5 * rig.exposure_s
        return -2 * np.pi * self.drive_hz * begin
