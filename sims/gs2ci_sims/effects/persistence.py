"""Persistence: charge trapped in the previous exposure is released in this one."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gs2ci.core.arrays import F64
from gs2ci.core.errors import InputError
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, enlarging_step, gain_step
from gs2ci_sims.effects.counts import most_counted_e
from gs2ci_sims.rig import RigFigures


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

    stage: ClassVar[LightStage] = LightStage.CHARGE
    cost_ns: ClassVar[float] = 3.0

    share: float
    decay_s: float
    gap_s: float
    earlier_e: float | F64

    def __post_init__(self) -> None:
        earlier = np.asarray(self.earlier_e)
        if not 0 <= self.share <= 1 or not 0 < self.decay_s < np.inf or not 0 <= self.gap_s < np.inf:
            raise InputError(
                f"persistence of {self.share} that decays in {self.decay_s} s, after a gap of {self.gap_s} s",
                allowed="a share of 0 to 1, decay_s > 0, gap_s >= 0, both finite",
            )
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
        dn = rig.dn_per_e * scene.gain_after(self)
        return Bound(dn * rms_e, dn * peak_e).by(
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
            enlarging_step(scene, self),
            gain_step(rig),
        )

    def added_e(self, rig: RigFigures, size: tuple[int, int]) -> tuple[float, float]:
        """Return the released charge: its mean and its largest."""
        released_e = self.released_share(rig.exposure_s) * np.asarray(self.earlier_e)
        return float(released_e.mean()), float(released_e.max())

    def apply(self, signal: F64, rig: RigFigures, rng: np.random.Generator) -> F64:
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
