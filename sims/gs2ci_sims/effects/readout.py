"""Effects on the way from charge to readings.

- Gain non-linearity: the reading is not quite proportional to the charge.
- Black level: the offset of all readings drifts off the data sheet's figure.
- Quantisation: the converter rounds to whole numbers within its range.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, FiniteFloat

from gs2ci.core.arrays import F64, Rng, rms_of
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, ViewPreview, gain_step
from gs2ci_sims.effects.counts import most_counted_e, most_in_sum
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class GainNonlinearity(EffectRecord):
    """Bend the response by a parabola that is zero at no charge and at the full well W.

    With x = charge / W, the amplifier puts out W (x + 4 d x (1 - x)): d is the largest departure from the straight
    line between the ends, as a share of the full scale. The linearity error LE of EMVA Standard 1288, Release 3.1,
    section 6, is defined similarly, relative to a fitted line.

    Args:
        departure: d, positive for a response that lies above the line, of magnitude below 1/4: it stays monotonic.
    """

    stage = LightStage.CHARGE
    cost_ns = 10.0

    departure: Annotated[float, Field(gt=-0.25, lt=0.25)]

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The parabola, its top from half the well on, of charge with shot noise; one exposure in 1e7 exceeds it.

        The limit for one exposure is that of a sum of squared changes (`counts.most_in_sum`) with a mean of r^2. The
        slope of such a square as a function of c^2, c the count, is at most (4 d)^2. So its variance is at most
        (4 d)^4 Var c^2, with Var c^2 = 4 q^3 + 6 q^2 + q for a mean q, and at most the largest square times their mean.
        """
        steps = self._over_exposures(scene, rig)
        expected_dn, slope, pixels = (
            steps[-1].value,
            4 * abs(self.departure) * rig.dn_per_e,
            int(np.prod(scene.scene.size)),
        )
        most_e = scene.most_e + scene.added_e[1]
        counted_dn = self._bent_dn(most_counted_e(most_e), rig)
        peak_dn, every_dn = float(counted_dn.max()), rms_of(counted_dn)
        mean_e, top_e = scene.charge_mean_e + scene.added_e[1], float(most_e.max())
        variance = min(slope**4 * mean_e * (4 * top_e**2 + 6 * top_e + 1), (expected_dn * peak_dn) ** 2)
        limit_dn = math.sqrt(most_in_sum(expected_dn**2, variance / pixels, peak_dn**2 / pixels / 3))
        return Bound(min(limit_dn, every_dn), peak_dn).by(
            "min(sqrt(r**2 + 6 * sqrt(d / n) + 6 * p**2 / n), every)",
            *steps,
            BoundStep("q", mean_e, "e", "charge, mean over the pixels"),
            BoundStep("T", top_e, "e", "upper bound of the charge of a pixel"),
            BoundStep("p", peak_dn, "DN", "change of the brightest pixel, with six sigma of its noise"),
            BoundStep(
                "d",
                variance,
                "DN^4",
                "variance of the squared change by shot noise, mean over the pixels",
                "min((4 * abs(D) * K)**4 * q * (4 * T**2 + 6 * T + 1), (r * p)**2)",
            ),
            BoundStep("n", pixels, "", "pixels"),
            BoundStep("every", every_dn, "DN", "rms with six sigma of noise in every pixel"),
        )

    def _over_exposures(self, scene: Previewed, rig: RigFigures) -> tuple[BoundStep, ...]:
        """Derive the rms over pixels and exposures, the last step.

        A count c of mean q has a mean square of q^2 + q, and the square of the change is at most a concave function of
        c^2. A count whose mean is larger by e has the law of the sum with another count of mean e.
        """
        error_e, added_e = scene.charge_error_e, scene.added_e[1]
        likely_dn, top_dn = (
            rms_of(self._bent_dn(np.sqrt(np.square(charge_e) + charge_e), rig))
            for charge_e in (scene.charge_e + added_e, scene.most_e + added_e)
        )
        error_dn = 4 * abs(self.departure) * rig.dn_per_e * math.sqrt(error_e**2 + error_e)
        return (
            BoundStep("D", self.departure, "", "largest departure from a line, of full scale"),
            gain_step(rig),
            BoundStep("e", error_e, "e", "error of the previewed charge, rms"),
            BoundStep("v", likely_dn, "DN", "4 D W x (1 - x) K at the previewed charge x W, rms over the pixels"),
            BoundStep(
                "u",
                error_dn,
                "DN",
                "the same of what it may differ by, with its shot noise, at the steepest slope",
                "4 * abs(D) * K * sqrt(e**2 + e)",
            ),
            BoundStep("top", top_dn, "DN", "the same at the upper bound of the charge"),
            BoundStep("r", min(likely_dn + error_dn, top_dn), "DN", "rms over pixels and exposures", "min(v + u, top)"),
        )

    def _bent_dn(self, charge_e: F64, rig: RigFigures) -> F64:
        """Return the magnitude of the parabola at these charges, its top from half the well on."""
        x = np.minimum(charge_e / rig.sensor.full_well_e, 0.5)
        return 4 * abs(self.departure) * rig.dn_per_e * rig.sensor.full_well_e * x * (1 - x)

    def brightest(self, scene: ViewPreview) -> float:
        """The steepest slope: it is the factor by which a change of the light before the amplifier grows."""
        return 1 + 4 * abs(self.departure)

    def apply(self, signal: F64, rig: RigFigures, rng: Rng) -> F64:
        """Bend electrons [H, W, C]; beyond the ends the response continues without the parabola."""
        x = np.clip(signal / rig.sensor.full_well_e, 0.0, 1.0)
        return signal + 4 * self.departure * rig.sensor.full_well_e * x * (1 - x)


@dataclass(frozen=True)
class BlackLevel(EffectRecord):
    """Shift all readings: the clamp's drift since the dark frames were taken.

    The offset mu_y.dark of EMVA Standard 1288, Release 3.1, section 2.1, is a figure of the data sheet
    (`Sensor.black_level_dn`) and always present; this effect is the difference of the true level from it. A shift down
    clips dark readings at 0 if the data sheet's level is too low for it.

    Args:
        shift_dn: True black level minus the data sheet's, DN.
    """

    stage = LightStage.READOUT
    cost_ns = 2.0

    shift_dn: FiniteFloat

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """Exactly the shift."""
        shift = BoundStep("D", self.shift_dn, "DN", "shift of the black level")
        return Bound(abs(self.shift_dn), abs(self.shift_dn)).by("abs(D)", shift)

    def lowered_dn(self, rig: RigFigures) -> float:
        """The shift, if it is one down."""
        return max(-self.shift_dn, 0.0)

    def apply(self, signal: F64, rig: RigFigures, rng: Rng) -> F64:
        """Shift readings [H, W, C]."""
        return signal + self.shift_dn


@dataclass(frozen=True)
class Quantisation(EffectRecord):
    """Round readings to whole DN and clip them to the converter's range.

    It adds a variance of 1/12 DN² if the signal varies by more than a step (EMVA Standard 1288, Release 3.1, section
    2.2).

    Args:
        bits: Bits of the converter, 1 to 32.
    """

    stage = LightStage.READOUT
    cost_ns = 5.0

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

    def apply(self, signal: F64, rig: RigFigures, rng: Rng) -> F64:
        """Round and clip readings [H, W, C]."""
        return np.clip(np.rint(signal), 0, self.max_dn)
