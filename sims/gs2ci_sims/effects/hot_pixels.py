"""Hot pixels: a few have a thousand times the dark current of the others."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from gs2ci.core.arrays import F64
from gs2ci.core.bounds import BoundedRecord
from gs2ci.core.config import NotNegative
from gs2ci_sims.effects.base import Bound, BoundStep, Previewed, Stage, gain_step
from gs2ci_sims.rig import Rig


@dataclass(frozen=True)
class HotPixels(BoundedRecord):
    """Give a random few pixels an excess dark current, exponentially distributed.

    The same pixels and currents in every exposure of one device. The tail of a sensor's dark current histogram is
    nearly exponential (Widenhorn et al., Proc. SPIE 4669 (2002); EMVA Standard 1288, Release 3.1, section 4, shows
    it as the straight flank of the logarithmic histogram).

    Args:
        share: Share of all pixels that are hot, 0 to 1.
        mean_e_per_s: Their mean excess, electrons per second, at least 0.
    """

    name: ClassVar[str] = "hot_pixels"
    stage: ClassVar[Stage] = Stage.CHARGE
    cost_ns: ClassVar[float] = 20.0
    fixed_pattern: ClassVar[bool] = True

    share: Annotated[float, Field(ge=0, le=1)]
    mean_e_per_s: NotNegative

    def bound(self, scene: Previewed, rig: Rig) -> Bound:
        """Moments of the exponential law, clipped at the full well, and six standard errors of their sample mean.

        For the charge x of a hot pixel of mean m, its own shot noise included: E x^2 = 2 m^2 + m,
        E x^4 = 24 m^4 + 36 m^3 + 14 m^2 + m (the factorial moments of a Poisson number of exponential mean are k! m^k).
        The hottest of k pixels exceeds m (ln k + 14) with a probability below exp(-14), one in a million.
        """
        mean_e, well_e = self.mean_e_per_s * rig.exposure_s, rig.sensor.full_well_e
        pixels = int(np.prod(scene.scene.size))
        second = self.share * min(2 * mean_e**2 + mean_e, well_e**2)
        fourth = self.share * min(24 * mean_e**4 + 36 * mean_e**3 + 14 * mean_e**2 + mean_e, well_e**4)
        hottest_e = min(self._hottest_e(mean_e, pixels), well_e)
        rms_e = np.sqrt(second + 6 * np.sqrt(fourth / pixels))
        return Bound(rig.dn_per_e * float(rms_e), rig.dn_per_e * float(hottest_e)).by(
            "K * sqrt(x2 + 6 * sqrt(x4 / n))",
            BoundStep("p", self.share, "", "share of the pixels that are hot"),
            BoundStep("I", self.mean_e_per_s, "e/s", "their mean excess current"),
            BoundStep("t", rig.exposure_s, "s", "exposure"),
            BoundStep("m", mean_e, "e", "their mean excess charge", "I * t"),
            BoundStep("W", rig.sensor.full_well_e, "e", "full well"),
            BoundStep("n", pixels, "", "pixels"),
            BoundStep(
                "x2",
                second,
                "e^2",
                "mean square of the excess charge and its shot noise",
                "p * min(2 * m**2 + m, W**2)",
            ),
            BoundStep(
                "x4",
                fourth,
                "e^4",
                "mean fourth power, likewise",
                "p * min(24 * m**4 + 36 * m**3 + 14 * m**2 + m, W**4)",
            ),
            gain_step(rig),
        )

    def added_e(self, rig: Rig, size: tuple[int, int]) -> tuple[float, float]:
        """Return the mean over all pixels, with six standard errors, and the hottest pixel's charge."""
        mean_e, pixels = self.mean_e_per_s * rig.exposure_s, int(np.prod(size))
        mean = self.share * mean_e + 6 * mean_e * float(np.sqrt(2 * self.share / pixels))
        return mean, self._hottest_e(mean_e, pixels)

    def _hottest_e(self, mean_e: float, pixels: int) -> float:
        return mean_e * float(np.log(max(self.share * pixels, 1.0)) + 14) if self.share > 0 else 0.0

    def apply(self, signal: F64, rig: Rig, rng: np.random.Generator) -> F64:
        """Add to mean electrons [H, W, C]."""
        hot = rng.random(signal.shape) < self.share
        return signal + hot * rng.exponential(self.mean_e_per_s * rig.exposure_s, signal.shape)
