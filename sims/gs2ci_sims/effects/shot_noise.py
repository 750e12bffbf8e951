"""Photon shot noise: the number of photons is Poisson distributed."""

from dataclasses import dataclass
from typing import ClassVar, Final

import numpy as np
from scipy.special import ndtri, pdtr

from gs2ci.core.arrays import F64
from gs2ci_sims.effects.base import Bound, BoundStep, EffectRecord, LightStage, Previewed, enlarging_step, gain_step
from gs2ci_sims.effects.counts import most_counted_e, most_in_sum
from gs2ci_sims.rig import RigFigures

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

    stage: ClassVar[LightStage] = LightStage.CHARGE
    cost_ns: ClassVar[float] = 400.0

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
        peak_e, every_e = float(beyond_e.max()), float(np.sqrt(np.square(beyond_e).mean()))
        variance = mean_e * (3 * largest_e + 1) / pixels
        rms_e = min(float(np.sqrt(most_in_sum(mean_e, variance, peak_e**2 / pixels / 3))), every_e)
        dn = rig.dn_per_e * after
        return Bound(dn * rms_e, dn * peak_e, random=True).by(
            "K * A * min(sqrt(Q + 6 * sqrt(Q * (3 * T + 1) / n) + 6 * p**2 / n), every)",
            BoundStep("Q", mean_e, "e", "charge, mean over the pixels: its variance over exposures"),
            BoundStep("T", largest_e, "e", "upper bound of the charge of a pixel"),
            BoundStep("p", peak_e, "e", "six sigma of the brightest pixel"),
            BoundStep("n", pixels, "", "pixels"),
            BoundStep("every", every_e, "e", "rms with six sigma in every pixel"),
            enlarging_step(scene, self),
            gain_step(rig),
        )

    def apply(self, signal: F64, rig: RigFigures, rng: np.random.Generator) -> F64:
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
