"""The sensor's temporal noise, estimated from a calibration's own frames: a variance linear in the signal.

Shot noise makes the variance grow with the reading, read-out adds a constant (EMVA Standard 1288, Release 3.1,
section 2.2). One line fitted to all pixels gives the variance of each pixel far better than its own few frames.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from gs2ci.core.arrays import F64
from gs2ci_calibration.refusals import CalibrationError, Reason

BINS: Final = 24
# Pixels whose variance exceeds the line's by more than this factor keep their own variance: they blink.
NOISY: Final = 6.0
# Quantisation alone gives a variance of 1/12; if all frames are the same, they are no live readings.
VARIANCE_MIN_DN2: Final = 1e-6
# In the dark, noise far below a DN is not visible at all; such bins must not outweigh all others.
LEAST_OF_MEAN: Final = 0.1


@dataclass(frozen=True)
class NoiseModel:
    """Variance of one reading.

    Args:
        floor_dn2: Variance without light, DN squared.
        slope_dn: Increase per DN of signal: the gain in DN per electron.
    """

    floor_dn2: float
    slope_dn: float

    def variance(self, signal_dn: NDArray[np.floating]) -> F64:
        """Return the variance at signals above dark, DN squared."""
        return self.floor_dn2 + self.slope_dn * np.maximum(signal_dn, 0.0)


def fit_noise(signal_dn: F64, variance_dn2: F64, step: str) -> NoiseModel:
    """Fit the line to signals and sample variances of many pixels, [P] each.

    Raises:
        CalibrationError: The frames do not vary at all.
    """
    if float(variance_dn2.mean()) < VARIANCE_MIN_DN2:
        raise CalibrationError(
            step,
            Reason.NO_VARIANCE,
            "all frames of a stack are the same",
            remedy="check that the sensor streams live frames, and expose so that readings exceed the black level",
        )
    kept = np.ones(len(signal_dn), bool)
    model = NoiseModel(float(variance_dn2.mean()), 0.0)
    for _ in range(2):
        model = _line(signal_dn[kept], variance_dn2[kept])
        # A sample variance of few frames scatters widely; pixels that blink exceed even that.
        kept = variance_dn2 < NOISY * 4 * np.maximum(model.variance(signal_dn), VARIANCE_MIN_DN2)
    return model


def _line(signal_dn: F64, variance_dn2: F64) -> NoiseModel:
    edges = np.quantile(signal_dn, np.linspace(0, 1, BINS + 1))
    place = np.clip(np.searchsorted(edges, signal_dn, side="right") - 1, 0, BINS - 1)
    count = np.bincount(place, minlength=BINS)
    filled = count > 0
    signal = np.bincount(place, signal_dn, BINS)[filled] / count[filled]
    variance = np.bincount(place, variance_dn2, BINS)[filled] / count[filled]
    # The error of a mean variance is proportional to it.
    least = max(LEAST_OF_MEAN * float(variance_dn2.mean()), VARIANCE_MIN_DN2)
    weight = np.sqrt(count[filled]) / np.maximum(variance, least)
    columns = np.column_stack([np.ones(len(signal)), np.maximum(signal, 0.0)]) * weight[:, None]
    (floor, slope), _ = nnls(columns, variance * weight)
    return NoiseModel(float(floor), float(slope))


def rounding_variance_dn2(variance_dn2: F64) -> F64:
    """Return the mean square by which rounding to whole DN biases readings of a variance, [...].

    It is the characteristic function of Gaussian noise at one cycle per DN, over pi: averaging frames does not reduce
    it, and with noise of half a DN it vanishes (Widrow and Kollar, Quantization Noise, 2008, section 4).
    """
    return np.exp(-4 * np.square(np.pi) * variance_dn2) / (2 * np.square(np.pi))


def own_variance(sample_dn2: F64, expected_dn2: F64, frames: int) -> F64:
    """Return each pixel's variance, [...]: the expected one, or its own if it blinks."""
    if frames < 3:
        return expected_dn2
    blinking = sample_dn2 > NOISY * 4 * expected_dn2
    return np.where(blinking, sample_dn2, expected_dn2)
