"""The photon transfer curve: electrons per DN, read noise, full well, and the range in which readings follow the light.

Pure: frames in, figures out. Not here: taking them (`photon_transfer`), single pixels (`dark_flat`).

Method: EMVA Standard 1288, Release 3.1, sections 2 and 6, with one change. A non-linear response, s = u (1 + 4 d (1 −
u / S)), also bends the photon transfer curve: its slope is (ds/du)² / G. So the non-linearity d is first fitted to the
signal as a function of the exposure, and the curve is corrected by it.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import nnls

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci_calibration.frames import (
    QUANTISATION_VARIANCE,
    SIGNIFICANT,
    Dark,
    check_drift,
    check_flicker,
    check_stack,
    noise_variance,
    root,
    rounding_variance_bias,
)
from gs2ci_calibration.refusals import CalibrationError, Reason

STEP: Final = "sensor"
LEVELS: Final = 12
CLEAR_SIGMAS: Final = 6.0
"""A level is below saturation if its brightest pixels are, by this many standard deviations of a reading."""
LEAST_LEVELS: Final = 5
RANGE_LIMIT: Final = 0.01
"""Readings count as linear while they follow the fitted curve within this, relative."""
BEND_LIMIT: Final = 0.05
"""Largest departure from a straight line, as a share of full scale."""
BRIGHT_QUANTILE: Final = 0.999


@dataclass(frozen=True)
class Full:
    """Readings of full pixels.

    Args:
        reading_dn: Mean of each pixel, [H, W].
        fill_s: Exposure at which the brighter ones are just full.
    """

    reading_dn: F64
    fill_s: float


@dataclass(frozen=True)
class ExposureSweep:
    """Flat frames over the exposures, taken upwards and downwards.

    Args:
        stacks: [K, H, W] DN each.
        exposures_s: Of each stack.
        times_s: When each stack began.
    """

    stacks: tuple[F32, ...]
    exposures_s: F64
    times_s: F64


@dataclass(frozen=True)
class SensorEstimate:
    """The estimates from the sweep; pairs are a value and its standard error.

    Args:
        gain_e_per_dn: Electrons per DN.
        read_noise_e: Temporal dark noise, quantisation noise subtracted.
        full_well_e: Electrons at the highest reading.
        saturation_dn: That reading.
        linearity_error: Largest departure from the straight line between black and saturation, as a share of it,
            positive if readings lie above it.
        linear_to_dn: Reading up to which they follow the fitted curve.
        limited_by: "well", or "converter" if that saturates first: the well is then larger.
        flicker: Rms change of the lamp from frame to frame, relative.
        signal_dn: Mean signal of each level, for the curve.
        variance_dn2: Temporal variance of each level.
        exposures_s: Exposure of each level.
    """

    gain_e_per_dn: tuple[float, float]
    read_noise_e: tuple[float, float]
    full_well_e: tuple[float, float]
    saturation_dn: tuple[float, float]
    linearity_error: tuple[float, float]
    linear_to_dn: tuple[float, float]
    limited_by: str
    flicker: float
    signal_dn: F64
    variance_dn2: F64
    exposures_s: F64


@dataclass(frozen=True)
class _Points:
    """The curve, one entry per stack, in DN and DN².

    Mean `signal` above dark and `charge` above black; `variance` of a pixel in time with its `freedom`; `fluctuation`:
    variance of the frames' means; `spread`: relative variance of the signal over the pixels; `clear`: whether all are
    safely below saturation.
    """

    exposure_s: F64
    time_s: F64
    signal: F64
    charge: F64
    variance: F64
    freedom: F64
    fluctuation: F64
    frames: F64
    spread: F64
    clear: Bool


@dataclass(frozen=True)
class _Bend:
    """The response s = u (1 + 4 d (1 − u / S)) of means over pixels: d, its standard error, S, residuals."""

    departure: float
    error: float
    full_dn: float
    residual: F64

    def straight(self, signal: F64, departure: float) -> F64:
        """Return u for a signal."""
        if abs(departure) < 1e-9:  # far below the resolution of any sweep; the difference below would lose digits
            return signal
        b, a = 1 + 4 * departure, 4 * departure / self.full_dn
        return 2 * signal / (b + np.sqrt(np.maximum(b * b - 4 * a * signal, 0.0)))

    def slope(self, straight: F64, departure: float) -> F64:
        """Return ds/du."""
        return 1 + 4 * departure * (1 - 2 * straight / self.full_dn)


def estimate(
    sweep: ExposureSweep, full: Full, dark: Dark, noise_dn: tuple[float, float], top_dn: int
) -> SensorEstimate:
    """Estimate the sensor's figures.

    Args:
        sweep: Flat frames over the exposures.
        full: Readings of full pixels.
        dark: The sensor's readings without light.
        noise_dn: Temporal dark noise with its standard error.
        top_dn: Largest reading.

    Raises:
        CalibrationError: Too few frames, frames all the same, unsteady light, readings that do not follow the light,
            or noise below that of rounding.
    """
    good = dark.good
    saturation_dn = float(full.reading_dn[good].mean())
    offset_dn = float(dark.offset_dn[good].mean())
    full_dn = saturation_dn - offset_dn
    points = _points(sweep, dark, full)
    flicker = _check_lamp(points)
    # Means over pixels that differ in brightness: the mean of squares is larger than the square of the mean.
    bend = _bend(points, full_dn / (1 + float(np.median(points.spread[points.clear]))))
    gain, gain_error = _gain(points, bend, noise_dn)
    read_noise = _read_noise(gain, gain_error, noise_dn, dark.offset_dn[good])
    linear_to, step_dn = _linear_range(points, bend, offset_dn)
    at_top = saturation_dn > top_dn - 0.5
    scatter = float(full.reading_dn[good].std()) / np.sqrt(int(good.sum()))
    return SensorEstimate(
        (gain, gain_error),
        read_noise,
        (full_dn * gain, float(np.hypot(full_dn * gain_error, scatter * gain))),
        (saturation_dn, scatter),
        (bend.departure, bend.error),
        (linear_to, step_dn),
        "converter" if at_top else "well",
        flicker,
        points.signal,
        points.variance,
        points.exposure_s,
    )


def _points(sweep: ExposureSweep, dark: Dark, full: Full) -> _Points:
    good, rows = dark.good, []
    ceiling = full.reading_dn[good]
    for frames, exposure_s in zip(sweep.stacks, sweep.exposures_s, strict=True):
        _check_live(frames, full)
        pixels = frames[:, good].astype(np.float64)
        mean, levels = pixels.mean(axis=0), pixels.mean(axis=1)
        lit = mean - dark.at(exposure_s)[good]
        variance, freedom = noise_variance(pixels, lit)
        near = float(np.quantile(mean - ceiling, BRIGHT_QUANTILE))
        signal = float(lit.mean())
        spread = max(float(lit.var()) - variance / len(frames), 0.0) / max(signal, 1.0) ** 2
        charge = float((mean - dark.offset_dn[good]).mean())
        clear = near < -CLEAR_SIGMAS * np.sqrt(variance)
        rows.append((signal, charge, variance, freedom, float(levels.var(ddof=1)), len(frames), spread, clear))
    signal, charge, variance, freedom, fluctuation, counts, spread, clear = np.array(rows).T
    time_s = sweep.times_s - sweep.times_s.mean()
    usable = np.asarray((clear > 0) & (signal > 0))
    points = _Points(sweep.exposures_s, time_s, signal, charge, variance, freedom, fluctuation, counts, spread, usable)
    if points.clear.sum() < LEAST_LEVELS:
        raise CalibrationError(
            STEP,
            Reason.SATURATED,
            f"{int(points.clear.sum())} of {len(rows)} levels are below saturation",
            allowed=f"{LEAST_LEVELS} or more",
            remedy="dim the lamp so that longer exposures fill the pixels",
        )
    return points


def _check_live(frames: F32, full: Full) -> None:
    """Check that frames are live, or all the same because every pixel is at the converter's top."""
    if len(frames) < 2 or float(np.median(frames)) < 0.98 * float(np.median(full.reading_dn)):
        check_stack(STEP, frames)


def _check_lamp(points: _Points) -> float:
    """Return the lamp's rms change from frame to frame, relative.

    Raises:
        CalibrationError: It is too large.
    """
    chosen = points.clear
    pixels = points.freedom / np.maximum(points.frames - 1, 1) + 1
    excess = (points.fluctuation - points.variance / pixels) / np.square(points.signal)
    noise = points.fluctuation / np.square(points.signal)
    freedom = float((points.frames - 1)[chosen].sum())
    weights = np.where(chosen, points.frames - 1, 0.0) / freedom
    flicker, error = root(float(weights @ excess), float(np.sqrt(2 / freedom) * (weights @ noise)))
    check_flicker(STEP, flicker, error)
    return flicker


def _bend(points: _Points, full_dn: float) -> _Bend:
    """Fit signal = c (E + δ)(1 + γ t)(1 + 4 d (1 − u / S)) by linear least squares, with relative errors.

    Raises:
        CalibrationError: The lamp drifts, or the readings follow no such curve.
    """
    use = points.clear
    exposure, time, signal = points.exposure_s[use], points.time_s[use], points.signal[use]
    span_s = float(np.ptp(time)) or 1.0
    columns = np.stack([np.ones_like(exposure), exposure, np.square(exposure), exposure * time / span_s], axis=1)
    sigma = _level_errors(points)[use]
    scale = np.abs(columns).max(axis=0)
    design = columns / scale / sigma[:, None]
    solution, *_ = np.linalg.lstsq(design, signal / sigma, rcond=None)
    residual = (signal / sigma - design @ solution) * sigma / signal
    freedom = max(len(signal) - columns.shape[1], 1)
    chi = max(float(np.square(residual * signal / sigma).sum()) / freedom, 1.0)
    covariance = np.linalg.inv(design.T @ design) * chi
    _, slope, square, drift = solution / scale
    check_drift(STEP, drift / slope, len(points.time_s))
    rms = float(np.sqrt(np.square(residual).mean()))
    departure = _departure(slope, square, full_dn)
    error = float(np.sqrt(covariance[2, 2])) / scale[2] * abs(full_dn / (4 * slope**2))
    if rms > RANGE_LIMIT or abs(departure) > BEND_LIMIT:
        raise CalibrationError(
            STEP,
            Reason.NOT_LINEAR,
            f"readings depart from a line by {100 * departure:.1f} % of the range, and from a parabola by "
            f"{100 * rms:.2f} % rms",
            allowed=f"{100 * BEND_LIMIT:.0f} % and {100 * RANGE_LIMIT:.0f} %",
            remedy="switch off automatic gain, exposure and tone curve; steady the lamp",
        )
    every = np.full(len(use), np.nan)
    every[use] = residual
    beyond = np.stack(
        [
            np.ones_like(points.signal),
            points.exposure_s,
            points.exposure_s**2,
            points.exposure_s * points.time_s / span_s,
        ]
    )
    every[~use] = points.signal[~use] / (solution / scale @ beyond[:, ~use]) - 1
    return _Bend(departure, error, full_dn, every)


def _level_errors(points: _Points) -> F64:
    """Return the standard error of each level: the pixels' noise, the lamp's flicker, the jitter of the exposure.

    The scatter of a level's frames gives the last two: beyond noise, their variance is a² s² + b².
    """
    pixels = points.freedom / np.maximum(points.frames - 1, 1) + 1
    noise = points.variance / pixels
    use = points.clear
    square = np.square(points.signal)
    weight = 1 / np.square(np.median(points.fluctuation[use]) + noise)[use]
    columns = np.stack([square, np.ones_like(square)], axis=1)
    shares, _ = nnls(columns[use] * weight[:, None], np.maximum(points.fluctuation - noise, 0.0)[use] * weight)
    # No lamp and no clock is steadier than one part in 100 000.
    return np.sqrt((noise + columns @ shares + 1e-10 * square) / points.frames)


def _departure(slope: float, square: float, full_dn: float) -> float:
    """Return d from signal = slope E + square E²: slope = c (1 + 4 d), square = −4 d c² / S."""
    departure = 0.0
    for _ in range(8):  # each iteration reduces the error by the factor 8 d, which is below a half
        departure = -square * full_dn / (4 * slope**2) * (1 + 4 * departure) ** 2
    return float(np.clip(departure, -0.2, 0.2))


def _gain(points: _Points, bend: _Bend, noise_dn: tuple[float, float]) -> tuple[float, float]:
    """Fit variance = σ_dark² + (ds/du)² u / G.

    Raises:
        CalibrationError: The variance does not grow with the signal.
    """
    use = points.clear
    variance, charge, freedom = points.variance[use], points.charge[use], points.freedom[use]
    dark_variance = noise_dn[0] ** 2

    def slope(departure: float, dark: float) -> tuple[float, float]:
        straight = bend.straight(charge, departure)
        bent = np.square(bend.slope(straight, departure))
        y = (variance - dark) / bent
        inverse = total = 1.0
        expected = np.ones_like(charge)
        for _ in range(3):
            # Weights by the curve, not by the samples: a sample that varies little by chance would weigh too much.
            weight = straight / np.square(expected / bent * np.sqrt(2 / freedom))
            total = float(weight @ straight)
            inverse = float(weight @ y) / total
            expected = dark + bent * straight * max(inverse, 0.0)
        return inverse, 1 / float(np.sqrt(total))

    inverse, random = slope(bend.departure, dark_variance)
    from_bend = slope(bend.departure + bend.error, dark_variance)[0] - inverse
    from_dark = slope(bend.departure, dark_variance + 2 * noise_dn[0] * noise_dn[1])[0] - inverse
    if inverse < SIGNIFICANT * random:
        raise CalibrationError(
            STEP,
            Reason.NO_VARIANCE,
            "the noise does not grow with the light, as that of photons does",
            remedy="switch off noise reduction; read the sensor with more bits",
        )
    gain = 1 / inverse
    return gain, float(np.sqrt(random**2 + from_bend**2 + from_dark**2)) * gain**2


def _read_noise(gain: float, gain_error: float, noise_dn: tuple[float, float], offsets_dn: F64) -> tuple[float, float]:
    """Return the dark noise in electrons, rounding noise subtracted.

    Raises:
        CalibrationError: The noise is no larger than that of rounding alone.
    """
    variance = noise_dn[0] ** 2 - QUANTISATION_VARIANCE
    error = 2 * noise_dn[0] * noise_dn[1]
    if variance < SIGNIFICANT * error:
        raise CalibrationError(
            STEP,
            Reason.NO_VARIANCE,
            f"dark noise of {noise_dn[0]:.2f} DN is no more than that of rounding, "
            f"{np.sqrt(QUANTISATION_VARIANCE):.2f} DN",
            remedy="read the sensor with more bits or more analogue gain",
        )
    sigma = float(np.sqrt(variance))
    error = float(np.hypot(error, rounding_variance_bias(sigma, offsets_dn)))
    return sigma * gain, float(np.hypot(error / (2 * sigma) * gain, sigma * gain_error))


def _linear_range(points: _Points, bend: _Bend, offset_dn: float) -> tuple[float, float]:
    """Return the reading up to which levels follow the curve, and half of the step between levels."""
    order = np.argsort(points.exposure_s)
    off = np.abs(bend.residual[order]) > RANGE_LIMIT
    levels = points.charge[order] + offset_dn
    last = int(np.argmax(off)) - 1 if off.any() else len(levels) - 1
    reached = float(levels[max(last, 0)])
    return reached, 0.5 * float(np.ptp(levels)) / (LEVELS - 1)
