"""Metrics of images compared with the truth, and of a prediction compared with its measurement.

Here: PSNR and SSIM per view; the measurement's residual, in its own unit and in units of its noise (chi-squared per
pixel). Not here: camera paths (`gs2ci.evaluate.trajectory`), depth, files.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from skimage.metrics import structural_similarity

from gs2ci.core.arrays import F32, F64, Bool, rms_of
from gs2ci.core.errors import InputError

# Identical images have no finite PSNR, and JSON has no infinity: a smaller mean squared error counts as this one, so
# that no figure exceeds 100 dB. Sixteen-bit quantisation alone gives 107 dB.
MSE_FLOOR: Final = 1e-10
SSIM_SIGMA_PX: Final = 1.5
# scikit-image cuts the Gaussian at 3.5 sigma: a radius of 5 pixels.
SSIM_WINDOW_PX: Final = 11


@dataclass(frozen=True)
class Residual:
    """The residual between a prediction and a measurement, in its own unit (full scale of one view).

    Args:
        rms: Root mean square over all samples.
        mean_abs: Mean absolute value over all samples.
    """

    rms: float
    mean_abs: float


def psnr_per_view(estimate: F32, truth: F32) -> list[float]:
    """Measure the peak signal-to-noise ratio of each view, in dB.

    Both stacks are clamped to [0, 1] first and the peak is 1; the squared error is averaged over the pixels and
    channels of a view. Averages over views are taken of these decibels. At most 100 dB (`MSE_FLOOR`).

    Args:
        estimate: [N, H, W, C], full scale 1.
        truth: The same shape.

    Raises:
        InputError: The shapes differ, or hold no view.
    """
    mse = [float(np.mean(np.square(a - b))) for a, b in _clamped(estimate, truth)]
    return [float(-10 * np.log10(max(value, MSE_FLOOR))) for value in mse]


def ssim_per_view(estimate: F32, truth: F32) -> list[float]:
    """Measure the structural similarity of each view (Wang et al. 2004), at most 1.

    scikit-image's `structural_similarity` with Wang's settings: Gaussian weights of sigma 1.5 (an 11 × 11 window),
    no sample covariance, data range 1; per channel, then averaged; both stacks clamped to [0, 1] first. An image
    with fewer than 11 pixels along a side is mirrored outwards to 11 first.

    Args:
        estimate: [N, H, W, C], full scale 1.
        truth: The same shape.

    Raises:
        InputError: The shapes differ, or hold no view.
    """
    short = [max(0, SSIM_WINDOW_PX - side) for side in estimate.shape[1:3]]
    margins = [*((gap // 2, gap - gap // 2) for gap in short), (0, 0)]
    return [
        float(
            structural_similarity(
                *(np.pad(view, margins, mode="symmetric") if any(short) else view for view in pair),
                gaussian_weights=True,
                sigma=SSIM_SIGMA_PX,
                use_sample_covariance=False,
                data_range=1.0,
                channel_axis=-1,
            )
        )
        for pair in _clamped(estimate, truth)
    ]


def image_scores(views: F32, truth: F32 | None) -> dict[str, Any]:
    """Score views, [N, H, W, C], in reports' form: `psnr_db` and `ssim`, each with its mean; None without a truth.

    Raises:
        InputError: The shapes differ, or hold no view.
    """
    if truth is None:
        return {"psnr_db": None, "ssim": None}
    scores = {"psnr_db": psnr_per_view(views, truth), "ssim": ssim_per_view(views, truth)}
    return {key: {"mean": float(np.mean(each)), "per_view": each} for key, each in scores.items()}


def measurement_residual(predicted: F32, measurement: F32, saturated: Bool | None = None) -> Residual:
    """Measure the residual between a prediction and a measurement.

    A saturated reading is only a lower bound: predictions above it count as exact there.

    Args:
        predicted: [H, W, C].
        measurement: The same shape.
        saturated: [H, W], or None.

    Raises:
        InputError: The shapes differ.
    """
    error = _apart(predicted, measurement)
    if saturated is not None:
        error = np.where(saturated[..., None], np.minimum(error, 0.0), error)
    return Residual(rms=rms_of(error), mean_abs=float(np.mean(np.abs(error))))


def _apart(predicted: F32, measurement: F32) -> F64:
    """Return the difference of a prediction from a measurement of the same shape."""
    if predicted.shape != measurement.shape:
        raise InputError(
            f"the predicted measurement has shape {list(predicted.shape)}", allowed=str(list(measurement.shape))
        )
    return predicted.astype(np.float64) - measurement


def _clamped(estimate: F32, truth: F32) -> Iterator[tuple[F64, F64]]:
    """Yield each view and its truth, [H, W, C]: of many exposures not all fit into memory in double precision."""
    if estimate.shape != truth.shape or estimate.ndim != 4 or 0 in estimate.shape:
        raise InputError(
            f"views {list(estimate.shape)} cannot be compared with true views {list(truth.shape)}",
            allowed="two stacks [N, H, W, C] of one shape",
        )
    for pair in zip(estimate, truth, strict=True):
        one, other = (np.clip(view.astype(np.float64), 0, 1) for view in pair)
        yield one, other


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
    terms = _apart(predicted, measurement) ** 2 / noise.variance(predicted)
    if saturated is not None:
        terms = terms[~saturated]
    return float(terms.mean()) if terms.size else None
