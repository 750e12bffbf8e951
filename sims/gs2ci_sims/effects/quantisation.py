"""Quantisation: the converter rounds to whole numbers within its range."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, gain_step
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class Quantisation(EffectRecord):
    """Round readings to whole DN and clip them to the converter's range.

    It adds a variance of 1/12 DN² if the signal varies by more than a step (EMVA Standard 1288, Release 3.1, section
    2.2).

    Args:
        bits: Bits of the converter, 1 to 32.
    """

    stage: ClassVar[LightStage] = LightStage.READOUT
    cost_ns: ClassVar[float] = 5.0

    bits: Annotated[int, Field(ge=1, le=32)]

    @property
    def max_dn(self) -> int:
        """Get the highest reading."""
        return int(2**self.bits - 1)

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """Rounding changes a reading by at most half a step; readings beyond the range are clipped at either end.

        Below it, each pixel counts as one without light whose noises all are at six standard deviations.
        """
        _, rms_e, peak_e = scene.excess_e(self, (self.max_dn - rig.sensor.black_level_dn) / rig.dn_per_e)
        below_dn = max(scene.lowered_dn - rig.sensor.black_level_dn, 0.0)
        rms_dn = float(np.hypot(np.hypot(0.5, rig.dn_per_e * rms_e), below_dn))
        return Bound(rms_dn, 0.5 + max(rig.dn_per_e * peak_e, below_dn)).by(
            "hypot(hypot(0.5, K * x), b)",
            BoundStep("bits", self.bits, "", "of the converter"),
            BoundStep("B", rig.sensor.black_level_dn, "DN", "black level by the data sheet"),
            BoundStep("l", scene.lowered_dn, "DN", "how far below it noises of six sigma and a shift take readings"),
            BoundStep("b", below_dn, "DN", "how far below 0", "max(l - B, 0)"),
            BoundStep("x", rms_e, "e", "charge beyond its range, with six sigma of its noise, rms over the pixels"),
            gain_step(rig),
        )

    def apply(self, signal: F64, rig: RigFigures, rng: np.random.Generator) -> F64:
        """Round and clip readings [H, W, C]."""
        return np.clip(np.rint(signal), 0, self.max_dn)
