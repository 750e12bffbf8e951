"""Effects on the charge in the pixels.

- Dark current: electrons freed by heat, in proportion to the exposure.
- Persistence: charge trapped in the previous exposure is released in this one.
- Full well: a pixel holds a limited number of electrons.
- Blooming: charge that a full pixel cannot hold spills along its column.
"""

from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from pydantic import Field, FiniteFloat

from gs2ci.core.arrays import F64, Rng
from gs2ci.core.config import NotNegative, Positive
from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, of_charge
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

    stage = LightStage.CHARGE
    cost_ns = 2.0

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
        return of_charge(
            scene,
            self,
            float(np.sqrt(dark_e**2 + dark_e)),
            float(most_counted_e(dark_e)),
            "K * A * sqrt(D**2 + D)",
            BoundStep("I", self.current_e_per_s, "e/s", "dark current at 25 C"),
            BoundStep("C", self.temperature_c, "C", "temperature of the sensor"),
            BoundStep("h", self.doubling_k, "K", "warming that doubles the current"),
            BoundStep("t", rig.exposure_s, "s", "exposure"),
            BoundStep("W", rig.sensor.full_well_e, "e", "full well"),
            BoundStep("D", dark_e, "e", "charge collected in the dark", "min(I * 2 ** ((C - 25) / h) * t, W)"),
        )

    def added_e(self, rig: RigFigures, size: tuple[int, int]) -> tuple[float, float]:
        """Return the collected charge, the same in every pixel."""
        return (self.collected_e(rig.exposure_s),) * 2

    def apply(self, signal: F64, rig: RigFigures, rng: Rng) -> F64:
        """Add to mean electrons [H, W, C]."""
        return signal + self.collected_e(rig.exposure_s)


@dataclass(frozen=True)
class Persistence(EffectRecord):
    """Add the charge that traps release during this exposure, after the previous exposure has filled them.

    A share of each pixel's earlier charge is trapped and released at a rate that decays exponentially, so an exposure
    of length T that begins a time g after the earlier one's end collects share x earlier charge x
    (exp(-g / tau) - exp(-(g + T) / tau)). One trap species of Smith et al., Proc. SPIE 7021 (2008); for the lag of
    pinned photodiodes see Fossum and Hondongwa, IEEE J. Electron Devices Soc. 2 (2014).

    Args:
        share: Share of the earlier charge that is trapped, 0 to 1.
        decay_s: tau, more than 0.
        gap_s: g, at least 0.
        earlier_e: Electrons of the earlier exposure: one number for a flat field, or an image that broadcasts to
            [H, W, C]; finite, at least 0.
    """

    stage = LightStage.CHARGE
    cost_ns = 3.0

    share: Annotated[float, Field(ge=0, le=1)]
    decay_s: Positive
    gap_s: NotNegative
    earlier_e: float | F64

    def __post_init__(self) -> None:
        super().__post_init__()
        earlier = np.asarray(self.earlier_e)
        if not (np.isfinite(earlier).all() and np.all(earlier >= 0)):
            raise InputError("persistence of an exposure with charges that no pixel holds", allowed="0 or more, finite")

    def released_share(self, exposure_s: float) -> float:
        """Get the share of the earlier charge that is released during an exposure."""
        started = np.exp(-self.gap_s / self.decay_s)
        return float(-self.share * started * np.expm1(-exposure_s / self.decay_s))

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The released charge, which is exact, and its shot noise, up to the full well, times K."""
        released_e = np.minimum(
            self.released_share(rig.exposure_s) * np.asarray(self.earlier_e), rig.sensor.full_well_e
        )
        rms_e = float(np.sqrt((np.square(released_e) + released_e).mean()))
        peak_e = float(most_counted_e(released_e).max())
        return of_charge(
            scene,
            self,
            rms_e,
            peak_e,
            "K * A * x",
            BoundStep("s", self.share, "", "share of the earlier charge that is caught"),
            BoundStep("tau", self.decay_s, "s", "decay"),
            BoundStep("gap", self.gap_s, "s", "time since the earlier exposure"),
            BoundStep("t", rig.exposure_s, "s", "exposure"),
            BoundStep(
                "c",
                self.released_share(rig.exposure_s),
                "",
                "share released during this one",
                "s * exp(-gap / tau) * (1 - exp(-t / tau))",
            ),
            BoundStep("x", rms_e, "e", "that charge and its shot noise, rms over the pixels, up to the full well"),
        )

    def added_e(self, rig: RigFigures, size: tuple[int, int]) -> tuple[float, float]:
        """Return the released charge: its mean and its largest."""
        released_e = self.released_share(rig.exposure_s) * np.asarray(self.earlier_e)
        return float(released_e.mean()), float(released_e.max())

    def apply(self, signal: F64, rig: RigFigures, rng: Rng) -> F64:
        """Add to mean electrons [H, W, C].

        Raises:
            InputError: The earlier image has another shape.
        """
        released_e = self.released_share(rig.exposure_s) * np.asarray(self.earlier_e)
        try:
            return signal + np.broadcast_to(released_e, signal.shape)
        except ValueError as error:
            raise InputError(
                f"persistence of an image of shape {list(released_e.shape)} on a signal of {list(signal.shape)}",
                allowed="one number, or an image of the signal's shape",
            ) from error


@dataclass(frozen=True)
class FullWell(EffectRecord):
    """Clip each pixel's charge at its capacity; what is beyond is lost (no blooming).

    The saturation capacity µ_e.sat of EMVA Standard 1288, Release 3.1, section 2.4.

    Args:
        capacity_e: Electrons, more than 0.
    """

    stage = LightStage.CHARGE
    cost_ns = 2.0

    capacity_e: Annotated[float, Field(gt=0)]

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """The charge beyond the capacity, with six standard deviations of its noise."""
        _, rms_e, peak_e = scene.excess_e(self, self.capacity_e)
        return of_charge(
            scene,
            self,
            rms_e,
            peak_e,
            "K * A * x",
            BoundStep("W", self.capacity_e, "e", "full well"),
            BoundStep("Q", float(scene.most_e.max()), "e", "upper bound of the charge of a pixel, without noise"),
            BoundStep("x", rms_e, "e", "charge beyond the well, with six sigma of its noise, rms over the pixels"),
        )

    def apply(self, signal: F64, rig: RigFigures, rng: Rng) -> F64:
        """Clip electrons [H, W, C]."""
        return np.minimum(signal, self.capacity_e)


@dataclass(frozen=True)
class Blooming(EffectRecord):
    """Let a share of each pixel's charge beyond the full well flow into its column, half up and half down.

    It fills every pixel that it reaches up to the well and flows on; what reaches the border is gone. The rest goes
    into the anti-blooming drain, hence share 1 is a sensor without one (Janesick, Scientific Charge-Coupled Devices
    (2001)). Acts before `full_well`, which clips what stays.

    Args:
        share: Share of the excess charge that spills, 0 to 1.
    """

    stage = LightStage.CHARGE
    cost_ns = 40.0

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
        return of_charge(
            scene,
            self,
            float(rms_e),
            peak_e,
            "K * A * sqrt(min(x, W) * W)",
            BoundStep("s", self.share, "", "share of the excess charge that spills"),
            BoundStep("W", rig.sensor.full_well_e, "e", "full well"),
            BoundStep("e", excess_e, "e", "charge beyond the well, with six sigma of its noise, mean over the pixels"),
            BoundStep("x", spilled_e, "e", "of it spilled, per pixel", "s * e"),
        )

    def apply(self, signal: F64, rig: RigFigures, rng: Rng) -> F64:
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
