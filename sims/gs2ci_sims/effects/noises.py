"""Effects by which pixels differ at random.

- Read noise: the amplifier's own contribution to every reading.
- Row noise: all pixels of a row share one draw, since they are read out at the same moment.
- Dark signal non-uniformity: every pixel has an offset of its own.
- Photo response non-uniformity: pixels convert different shares of their light into charge.
- Photon shot noise: the number of photons is Poisson distributed.
- Hot pixels: a few have a thousand times the dark current of the others.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from pydantic import Field
from scipy.special import ndtri, pdtr

from gs2ci.core.arrays import F64, Rng, rms_of
from gs2ci.core.config import NotNegative
from gs2ci_sims.effects.base import (
    Bound,
    BoundStep,
    EffectRecord,
    LightStage,
    Previewed,
    ViewPreview,
    enlarging_step,
    gain_step,
    of_charge,
)
from gs2ci_sims.effects.counts import SIGMAS, most_counted_e, most_in_sum
from gs2ci_sims.rig import RigFigures


@dataclass(frozen=True)
class ChargeNoise(EffectRecord):
    """Normal numbers that an effect adds to the electrons, drawn in its own way."""

    stage = LightStage.CHARGE

    sigma_e: NotNegative

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """Standard deviation times the gain K (EMVA 1288, eq. 10), whatever the scene."""
        sigma = BoundStep("sigma", self.sigma_e, "e", "standard deviation")
        bound = Bound(self.sigma_e * rig.dn_per_e, self.lowered_dn(rig), random=True)
        return bound.by("K * sigma", sigma, gain_step(rig))

    def lowered_dn(self, rig: RigFigures) -> float:
        """Six standard deviations."""
        return SIGMAS * self.sigma_e * rig.dn_per_e


@dataclass(frozen=True)
class ReadNoise(ChargeNoise):
    """Add normal noise, in electrons at the input: σ_d of EMVA Standard 1288, Release 3.1, section 2.2.

    Args:
        sigma_e: Standard deviation in electrons, at least 0.
    """

    cost_ns = 20.0

    def apply(self, signal: F64, rig: RigFigures, rng: Rng) -> F64:
        """Add noise to electrons [H, W, C]; the sum may be negative, as a reading below black is."""
        return signal + self.sigma_e * rng.standard_normal(signal.shape)


@dataclass(frozen=True)
class RowNoise(ChargeNoise):
    """Add one normal number to each row, new in every exposure, in electrons at the input.

    Correlated temporal noise of supply and reference voltages, visible where it exceeds a tenth of the pixel noise
    (Nakamura, Image Sensors and Signal Processing for Digital Still Cameras (2006), section 3.3).

    Args:
        sigma_e: Standard deviation in electrons, at least 0.
    """

    cost_ns = 2.0

    def apply(self, signal: F64, rig: RigFigures, rng: Rng) -> F64:
        """Add to electrons [H, W, C], the same over W and C."""
        return signal + self.sigma_e * rng.standard_normal((len(signal), 1, 1))


@dataclass(frozen=True)
class Dsnu(ChargeNoise):
    """Add to each pixel an offset that is the same in every exposure of one device, normally distributed.

    DSNU_1288 of EMVA Standard 1288, Release 3.1, section 4, in electrons: the spatial standard deviation of the
    dark signal at short exposures. The offsets arise behind the photodiode, hence after counting and clipping; what
    grows with the exposure time is `dark_current`'s and `hot_pixels`'.

    Args:
        sigma_e: Standard deviation in electrons, at least 0.
    """

    cost_ns = 20.0
    fixed_pattern = True

    def apply(self, signal: F64, rig: RigFigures, rng: Rng) -> F64:
        """Add the pattern to electrons [H, W, C]; the sum may be negative, as a reading below black is."""
        return signal + self.sigma_e * rng.standard_normal(signal.shape)


@dataclass(frozen=True)
class Prnu(EffectRecord):
    """Multiply each pixel's charge by a factor of its own, normally distributed around 1.

    PRNU_1288 of EMVA Standard 1288, Release 3.1, section 4: the spatial standard deviation of the response,
    relative to its mean. The same pattern in every exposure of one device; it acts before electrons are counted,
    for it is a spread of quantum efficiencies.

    Args:
        spread: Relative standard deviation, 0 to 0.5 (0.01 is usual); no factor falls below 0.
    """

    stage = LightStage.CHARGE
    cost_ns = 20.0
    fixed_pattern = True

    spread: Annotated[float, Field(ge=0, le=0.5)]

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """Spread times charge, times K; one device in 1e7 exceeds it, even if masks leave light in a single pixel.

        The mean square over devices is v. The limit for one device is that of a sum of squared normal numbers
        (`counts.most_in_sum`) with weights of sum v, the largest of them b; and each factor is within six standard
        deviations. Charge beyond the full well is clipped with and without the effect: a pixel above the well loses
        at most (1 - factor) of the well's charge to it, one below its share of its own.
        """
        after = scene.gain_after(self)
        most_e = np.minimum(scene.most_e / after, rig.sensor.full_well_e)
        rms_e, top_e = min(scene.charge_rms_e / after, rms_of(most_e)), float(most_e.max())
        dn, pixels = self.spread * rig.dn_per_e * after, int(np.prod(scene.scene.size))
        mean, largest = (dn * rms_e) ** 2, (dn * top_e) ** 2 / pixels
        limit = math.sqrt(min(most_in_sum(mean, 2 * mean * largest, 2 * largest), SIGMAS**2 * mean))
        return Bound(limit, SIGMAS * dn * top_e, random=True).by(
            "sqrt(min(v + 6 * sqrt(2 * v * b) + 36 * b, 36 * v))",
            BoundStep("s", self.spread, "", "relative spread of the pixels' response"),
            BoundStep("Q", rms_e, "e", "charge, rms over the pixels"),
            BoundStep("T", top_e, "e", "upper bound of the charge of a pixel"),
            BoundStep("n", pixels, "", "pixels"),
            enlarging_step(scene, self),
            gain_step(rig),
            BoundStep("v", mean, "DN^2", "mean square over the pixels and over devices", "(K * A * s * Q)**2"),
            BoundStep(
                "b", largest, "DN^2", "what one pixel adds to it at most, mean over devices", "(K * A * s * T)**2 / n"
            ),
        )

    def brightest(self, scene: ViewPreview) -> float:
        """Six standard deviations above the mean."""
        return 1 + 6 * self.spread

    def apply(self, signal: F64, rig: RigFigures, rng: Rng) -> F64:
        """Scale mean electrons [H, W, C]."""
        return signal * np.maximum(1 + self.spread * rng.standard_normal(signal.shape), 0.0)


# Above this mean the error of the quantile's third-order expansion is below a tenth of an electron within eight
# standard deviations, so the rounded expansion is used without a correction.
EXACT_MAX_E: Final = 1e4


@dataclass(frozen=True)
class ShotNoise(EffectRecord):
    """Draw each pixel's electrons from the Poisson distribution of its mean.

    Absorbed photons are a thinned Poisson process, and therefore Poisson distributed: variance = mean (EMVA Standard
    1288, Release 3.1, section 2.2). Saturation follows later along the path.

    One uniform number per pixel is drawn and mapped by the quantile function of its Poisson distribution. Two
    simulations with slightly different means therefore give slightly different counts (the monotone coupling), whereas
    rejection samplers would draw again: this makes a plan comparable with the full simulation of the same seed.
    """

    stage = LightStage.CHARGE
    cost_ns = 400.0

    def bound(self, scene: Previewed, rig: RigFigures) -> Bound:
        """Standard deviation sqrt(mean), times the gain K (EMVA 1288, eq. 10); one exposure in 1e7 exceeds it.

        Dark charge counts too. The mean square over exposures is Q. The limit for one exposure is that of a sum of
        squared deviations (`counts.most_in_sum`); the fourth central moment of a count of mean q is 3 q^2 + q. It is
        about a percent above the standard deviation at VGA, 15 % at 64 x 48 pixels.
        """
        (added_mean_e, added_most_e), after = scene.added_e, scene.gain_after(self)
        most_e = np.minimum(scene.most_e / after + added_most_e, rig.sensor.full_well_e)
        mean_e = min(scene.charge_mean_e / after + added_mean_e, float(most_e.mean()))
        # This is for counts above the mean; below it, six standard deviations are enough for any mean.
        beyond_e, largest_e, pixels = (
            most_counted_e(most_e) - most_e,
            float(most_e.max()),
            int(np.prod(scene.scene.size)),
        )
        peak_e, every_e = float(beyond_e.max()), rms_of(beyond_e)
        variance = mean_e * (3 * largest_e + 1) / pixels
        rms_e = min(float(np.sqrt(most_in_sum(mean_e, variance, peak_e**2 / pixels / 3))), every_e)
        return of_charge(
            scene,
            self,
            rms_e,
            peak_e,
            "K * A * min(sqrt(Q + 6 * sqrt(Q * (3 * T + 1) / n) + 6 * p**2 / n), every)",
            BoundStep("Q", mean_e, "e", "charge, mean over the pixels: its variance over exposures"),
            BoundStep("T", largest_e, "e", "upper bound of the charge of a pixel"),
            BoundStep("p", peak_e, "e", "six sigma of the brightest pixel"),
            BoundStep("n", pixels, "", "pixels"),
            BoundStep("every", every_e, "e", "rms with six sigma in every pixel"),
            random=True,
        )

    def apply(self, signal: F64, rig: RigFigures, rng: Rng) -> F64:
        """Draw counted electrons for mean electrons [H, W, C]."""
        uniform = np.clip(rng.random(signal.shape), 1e-16, 1 - 2**-53)
        return poisson_quantile(uniform, signal)


def poisson_quantile(uniform: F64, mean: F64) -> F64:
    """Return the smallest count whose cumulative probability reaches `uniform`, elementwise.

    Cornish and Fisher's expansion to third order gives the start (Biometrika 4 (1938)); up to `EXACT_MAX_E` it is then
    corrected by the cumulative distribution itself.
    """
    z = ndtri(uniform)
    root = np.sqrt(mean)
    count = np.rint(mean + root * z + (z**2 - 1) / 6 - (z**3 - z) / (72 * np.maximum(root, 0.1)) - 0.0)
    count = np.maximum(count, 0.0)
    exact = np.flatnonzero(mean <= EXACT_MAX_E)
    flat_mean, flat_uniform = np.broadcast_to(mean, count.shape).ravel(), uniform.ravel()
    flat = count.ravel()
    low = exact
    while low.size:  # too low: climb
        low = low[pdtr(flat[low], flat_mean[low]) < flat_uniform[low]]
        flat[low] += 1
    high = exact[flat[exact] > 0]
    while high.size:  # too high: descend
        high = high[pdtr(flat[high] - 1, flat_mean[high]) >= flat_uniform[high]]
        flat[high] -= 1
        high = high[flat[high] > 0]
    return flat.reshape(count.shape)


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

    stage = LightStage.CHARGE
    cost_ns = 20.0
    fixed_pattern = True

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
        return of_charge(
            scene,
            self,
            float(np.sqrt(square_e2)),
            float(hottest_e),
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

    def apply(self, signal: F64, rig: RigFigures, rng: Rng) -> F64:
        """Add to mean electrons [H, W, C]."""
        hot = rng.random(signal.shape) < self.share
        return signal + hot * rng.exponential(self.mean_e_per_s * rig.exposure_s, signal.shape)
