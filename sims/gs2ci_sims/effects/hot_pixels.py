"""Hot pixels: a few have a thousand times the dark current of the others."""

from dataclasses import dataclass
from typing import Annotated, ClassVar, Final

import numpy as np
from pydantic import Field

from gs2ci.core.arrays import F64
from gs2ci.core.config import NotNegative
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, enlarging_step, gain_step
from gs2ci_sims.effects.counts import SIGMAS, most_in_sum
from gs2ci_sims.rig import RigFigures

# Of Chernoff's limit: edges of the charge, and the values of s, as multiples of 1 / hottest^2. Each s gives a limit
# that holds, and with more of them the least one changes by less than 2 %.
_EDGES: Final = 400
_POWERS: Final = 40
_CHERNOFF: Final = (0.1, 100.0)


@dataclass(frozen=True)
class HotPixels(EffectRecord):
    """Give a random few pixels an excess dark current, exponentially distributed.

    The same pixels and currents in every exposure of one device. The tail of a sensor's dark current histogram is
    nearly exponential (Widenhorn et al., Proc. SPIE 4669 (2002); EMVA Standard 1288, Release 3.1, section 4, shows
    it as the straight flank of the logarithmic histogram).

    Args:
        share: Share of all pixels that are hot, 0 to 1.
        mean_e_per_s: Their mean excess, electrons per second, at least 0.
    """

    stage: ClassVar[LightStage] = LightStage.CHARGE
    cost_ns: ClassVar[float] = 20.0
    fixed_pattern: ClassVar[bool] = True

    share: Annotated[float, Field(ge=0, le=1)]
    mean_e_per_s: NotNegative

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """Limits of the sum of the squared excess charges, and of the largest, of one exposure of one device.

        The charge of a hot pixel of mean m, its own shot noise included, is at least j electrons with a probability of
        (m / (1 + m))^j: a Poisson number with an exponential mean. The hottest of k pixels reaches
        (ln k + 14) / ln(1 + 1 / m) electrons with a probability below exp(-14), one in a million. The limit of the sum
        is Chernoff's (`_most_squares_e2`); six standard errors of the sum would be exceeded once in several hundred
        devices if only a few pixels are hot, since one of them may be most of it.
        """
        mean_e, well_e = self.mean_e_per_s * rig.exposure_s, rig.sensor.full_well_e
        pixels = int(np.prod(scene.scene.size))
        hottest_e = min(self._deepest_tail(pixels) / np.log1p(1 / mean_e), well_e) if mean_e > 0 else 0.0
        square_e2 = self._most_squares_e2(mean_e, hottest_e, pixels) / pixels
        dn = rig.dn_per_e * scene.gain_after(self)
        return Bound(dn * float(np.sqrt(square_e2)), dn * float(hottest_e)).by(
            "K * A * sqrt(x2)",
            BoundStep("p", self.share, "", "share of the pixels that are hot"),
            BoundStep("I", self.mean_e_per_s, "e/s", "their mean excess current"),
            BoundStep("t", rig.exposure_s, "s", "exposure"),
            BoundStep("m", mean_e, "e", "their mean excess charge", "I * t"),
            BoundStep("W", rig.sensor.full_well_e, "e", "full well"),
            BoundStep("h", hottest_e, "e", "the hottest pixel, at most W; exceeded in one exposure of a million"),
            BoundStep("n", pixels, "", "pixels"),
            BoundStep(
                "x2",
                square_e2,
                "e^2",
                "mean square of the excess charges and their shot noise in one exposure, exceeded once in 1e7: the "
                "least (18 / n + p * mean(exp(s * x**2) - 1)) / s over all s, for charges x of at most h",
            ),
            enlarging_step(scene, self),
            gain_step(rig),
        )

    def added_e(self, rig: RigFigures, size: tuple[int, int]) -> tuple[float, float]:
        """Return limits of the mean excess charge over all pixels and of the hottest pixel's, without shot noise.

        The sum of exponential numbers of mean m is sub-gamma with scale m (`counts.most_in_sum`).
        """
        mean_e, pixels = self.mean_e_per_s * rig.exposure_s, int(np.prod(size))
        if self.share == 0:
            return 0.0, 0.0
        hot = self.share * pixels
        return most_in_sum(hot * mean_e, 2 * hot * mean_e**2, mean_e) / pixels, mean_e * self._deepest_tail(pixels)

    def _deepest_tail(self, pixels: int) -> float:
        """Return how many times its mean an exponential number reaches in the hottest pixel; 0 if none is hot."""
        return float(np.log(max(self.share * pixels, 1.0)) + 14) if self.share > 0 else 0.0

    def _most_squares_e2(self, mean_e: float, hottest_e: float, pixels: int) -> float:
        """Return a limit of the sum of all squared excess charges.

        Chernoff: a sum over n pixels, each hot with probability p, exceeds (18 + n p E(exp(s x^2) - 1)) / s with a
        probability of at most exp(-18), for every s > 0 (Boucheron, Lugosi and Massart, Concentration Inequalities,
        section 2.2). The expectation is taken from above, with x rounded up to the next of a few hundred edges.
        """
        if hottest_e == 0:
            return 0.0
        edges = np.linspace(0, hottest_e, _EDGES)
        # The probability of more than an edge's charge.
        beyond = np.exp(-np.log1p(1 / mean_e) * (np.floor(edges[:-1]) + 1))
        powers = np.geomspace(*_CHERNOFF, _POWERS)[:, None] / hottest_e**2
        expected = np.diff(np.expm1(powers * edges**2), axis=1) @ beyond
        limits = (SIGMAS**2 / 2 + self.share * pixels * expected) / powers[:, 0]
        return float(limits.min())

    def apply(self, signal: F64, rig: RigFigures, rng: np.random.Generator) -> F64:
        """Add to mean electrons [H, W, C]."""
        hot = rng.random(signal.shape) < self.share
        return signal + hot * rng.exponential(self.mean_e_per_s * rig.exposure_s, signal.shape)
