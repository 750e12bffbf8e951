"""The measurement's residual in units of its noise: chi-squared per pixel.

Here: the noise of a sensor in full scales, and a prediction's residual in units of it. Not here: residuals in the
measurement's own unit (`gs2ci.evaluate.metrics`).
"""

from dataclasses import dataclass

import numpy as np

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.errors import InputError


@dataclass(frozen=True)
class SensorNoise:
    """Noise of a measurement: σ² = read² + signal / electrons (EMVA 1288, eq. 12), in full scales of one view.

    Args:
        read: Standard deviation in the dark, in full scales of one view: read noise and quantisation.
        electrons: Electrons of a pixel at the full scale of one view; infinite for no shot noise.
    """

    read: float
    electrons: float = float("inf")

    def __post_init__(self) -> None:
        """Refuse noise figures by which residuals cannot be divided.

        Raises:
            InputError: The read noise is negative or not finite, the electrons are not above 0, or there is no noise.
        """
        if not (0 <= self.read < np.inf and self.electrons > 0):
            raise InputError(f"noise {self.read} with {self.electrons} electrons", allowed="noise >= 0, electrons > 0")
        if self.read == 0:
            raise InputError("a read noise of 0", allowed="above 0: a dark pixel would have no noise at all")

    def variance(self, signal: F32) -> F64:
        """Return σ² of every sample, in squared full scales, for its expected signal, [H, W, C]."""
        return self.read**2 + np.maximum(signal.astype(np.float64), 0) / self.electrons


def chi_squared_per_pixel(
    predicted: F32, measurement: F32, noise: SensorNoise, saturated: Bool | None = None
) -> float | None:
    """Measure the mean squared residual in units of the noise that the prediction implies.

    It is about 1 if the residual is only noise; well below 1 if noise was fitted, well above 1 if the views do not
    explain the measurement. Saturated pixels are left out.

    Args:
        predicted: [H, W, C], in full scales of one view.
        measurement: The same shape.
        noise: Noise of the sensor.
        saturated: [H, W], or None.

    Returns:
        The mean over samples; None if every pixel is saturated.

    Raises:
        InputError: The shapes differ.
    """
    if predicted.shape != measurement.shape:
        raise InputError(
            f"the predicted measurement has shape {list(predicted.shape)}", allowed=str(list(measurement.shape))
        )
    terms = (predicted.astype(np.float64) - measurement) ** 2 / noise.variance(predicted)
    if saturated is not None:
        terms = terms[~saturated]
    return float(terms.mean()) if terms.size else None
