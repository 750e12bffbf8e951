"""The photon transfer curve: electrons per DN, read noise, full well, and up to where readings follow the light.

Here: the procedure `measure` and its pure estimators. Not here: single pixels (`dark_flat`, on which this builds).
`procedures` and tests import this file.

Method: EMVA Standard 1288, Release 3.1, sections 2 and 6, with one change. A response that bends, s = u (1 + 4 d (1 −
u / S)), also bends the photon transfer curve: its slope is (ds/du)² / G. The bend d is fitted to the signal against the
exposure first, and the curve is straightened by it.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci_calibration.bench import Bench, Setup, Stack
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.exposing import find_exposure, limits_s
from gs2ci_calibration.frames import (
    QUANTISATION_VARIANCE,
    SIGNIFICANT,
    Dark,
    Flags,
    check_drift,
    check_flicker,
    check_stack,
    root,
    rounding_variance_bias,
)
from gs2ci_calibration.refusals import CalibrationError, Reason

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

STEP: Final = "sensor"
START_SHARE: Final = 0.5
LEVELS: Final = 12
LOWEST_SHARE: Final = 0.04
HIGHEST_SHARE: Final = 1.04
"""Exposures of the sweep over the one that fills the pixels: from nearly none to just beyond."""
OVERFULL: Final = (1.6, 2.0)
"""Exposures at which all pixels are full, over the one that fills them."""
FULL_TOLERANCE: Final = 0.005
"""By how much the reading of full pixels may still grow between these two."""
CLEAR_SIGMAS: Final = 6.0
"""A level is below saturation when its brightest pixels are, by this many standard deviations of a reading."""
LEAST_LEVELS: Final = 5
RANGE_LIMIT: Final = 0.01
"""Readings count as linear while they follow the fitted curve within this, relative."""
BEND_LIMIT: Final = 0.05
"""Largest departure from a straight line, as a share of full scale."""
BRIGHT_QUANTILE: Final = 0.999


def measure(bench: Bench, known: Bundle) -> Section:
    """Sweep the exposure before an even light and return the section `sensor`.

    Raises:
        CalibrationError: `dark-flat` is missing; light too strong, too weak or unsteady; readings that do not follow
            it, or without noise.
        DriverError: A device failed.
    """
    section = known.need("dark-flat", STEP)
    dark = Dark.of(section)
    noise = section.estimates["dark_noise_rms_dn"]
    bench.please(Setup.FLAT)
    start = find_exposure(bench, STEP, dark, START_SHARE)
    full = _take_full(bench, dark, start.rate_dn_per_s)
    sweep = _take_sweep(bench, dark, full)
    found = estimate(sweep, full, dark, (float(noise), float(noise.error)), bench.top_dn)
    return _section(bench, found)


@dataclass(frozen=True)
class Full:
    """What pixels read that are full.

    Args:
        reading_dn: Each one's mean, [H, W].
        fill_s: Exposure at which the brighter ones are just full.
    """

    reading_dn: F64
    fill_s: float


@dataclass(frozen=True)
class Sweep:
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
    """What the sweep tells; pairs are a value and its standard error.

    Args:
        gain_e_per_dn: Electrons of one DN.
        read_noise_e: Temporal dark noise, quantisation taken off.
        full_well_e: Electrons at which readings end.
        saturation_dn: The reading there.
        linearity_error: Largest departure from the straight line between black and saturation, as a share of it,
            positive where readings lie above.
        linear_to_dn: Reading up to which they follow the fitted curve.
        limited_by: "well", or "converter" where that ends first: the well is then larger.
        flicker: Rms change of the lamp from frame to frame, relative.
        signal_dn: Mean signal of each level, for the curve.
        variance_dn2: Temporal variance of each level.
        exposures_s: Of each level.
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
    """The curve, one entry per stack: `signal` above dark, `charge` above black, `variance`, `freedom`, `fluctuation`.

    All in DN but for the last two; `clear` says which are safely below saturation.
    """

    exposure_s: F64
    time_s: F64
    signal: F64
    charge: F64
    variance: F64
    freedom: F64
    fluctuation: F64
    frames: F64
    clear: Flags


@dataclass(frozen=True)
class _Bend:
    """The response s = u (1 + 4 d (1 − u / S)): d with its standard error, S, and how far the levels scatter."""

    departure: float
    error: float
    full_dn: float
    residual: F64

    def straight(self, signal: F64, departure: float) -> F64:
        """Return u for a signal."""
        if abs(departure) < 1e-9:  # 1e-9: far below what any sweep resolves; the root's difference would lose digits
            return signal
        b, a = 1 + 4 * departure, 4 * departure / self.full_dn
        return np.asarray(2 * signal / (b + np.sqrt(np.maximum(b * b - 4 * a * signal, 0.0))))

    def slope(self, straight: F64, departure: float) -> F64:
        """Return ds/du."""
        return np.asarray(1 + 4 * departure * (1 - 2 * straight / self.full_dn))


def estimate(sweep: Sweep, full: Full, dark: Dark, noise_dn: tuple[float, float], top_dn: int) -> SensorEstimate:
    """Estimate the sensor's figures.

    Args:
        sweep: Flat frames over the exposures.
        full: Readings of full pixels.
        dark: What the sensor reads without light.
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
    bend = _bend(points, full_dn)
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


def _take_full(bench: Bench, dark: Dark, rate_dn_per_s: float) -> Full:
    """Fill the pixels and see that more light changes nothing."""
    _, longest_s = limits_s(bench)
    pattern = bench.flat_pattern(is_open=True)[None]
    good, offset_dn = dark.good, float(np.median(dark.offset_dn))
    typical = float(
        np.median(_mean(bench.grab(pattern, frames=2, exposure_s=_within(bench, 0.4, rate_dn_per_s)))[good])
    )
    base_s = (bench.top_dn - offset_dn) / rate_dn_per_s
    # The dimmest pixels have to fill too; find_exposure went by the brightest.
    dim = max((typical - offset_dn) / (0.4 * (bench.top_dn - offset_dn)), 0.3)
    means = []
    for share in OVERFULL:
        exposure_s = share * base_s / dim
        if exposure_s > longest_s:
            raise CalibrationError(
                STEP,
                Reason.NO_LIGHT,
                f"the flat field would take {exposure_s:.3g} s to fill the pixels",
                allowed=f"at most {longest_s:.3g} s",
                remedy="brighten the lamp or open the aperture",
            )
        means.append(_mean(bench.grab(pattern, frames=4, exposure_s=exposure_s)))
    growth = float(np.median((means[1] - means[0])[good])) / (float(np.median(means[1][good])) - offset_dn)
    if growth > FULL_TOLERANCE:
        raise CalibrationError(
            STEP,
            Reason.NOT_LINEAR,
            f"readings still grow by {100 * growth:.1f} % at {OVERFULL[1]:.1f} times the exposure that fills the range",
            allowed=f"at most {100 * FULL_TOLERANCE:.1f} %",
            remedy="switch off automatic gain and any tone curve of the sensor",
        )
    full_dn = float(np.mean(means[1][good])) - offset_dn
    return Full(means[1], full_dn / rate_dn_per_s)


def _within(bench: Bench, share: float, rate_dn_per_s: float) -> float:
    shortest_s, longest_s = limits_s(bench)
    return float(np.clip(share * bench.top_dn / rate_dn_per_s, shortest_s, longest_s))


def _take_sweep(bench: Bench, dark: Dark, full: Full) -> Sweep:
    """Take all levels upwards and then downwards: a lamp that drifts steadily then changes no level against another."""
    shortest_s, _ = limits_s(bench)
    lowest = max(LOWEST_SHARE, shortest_s / full.fill_s)
    shares = np.linspace(lowest, HIGHEST_SHARE, LEVELS)
    frames = max(bench.options.frames // 4, 2)
    pattern = bench.flat_pattern(is_open=True)[None]
    bench.progress.stage("exposure sweep", 2 * LEVELS)
    stacks = []
    for done, share in enumerate((*shares, *shares[::-1])):
        stacks.append(bench.grab(pattern, frames=frames, exposure_s=float(share) * full.fill_s))
        mean_dn = float(stacks[-1].readings.mean())
        bench.progress.step(done + 1, mean_dn=mean_dn, exposure_ms=1e3 * stacks[-1].exposure_s)
    return Sweep(
        tuple(stack.readings[0] for stack in stacks),
        np.array([stack.exposure_s for stack in stacks]),
        np.array([float(stack.time_s.mean()) for stack in stacks]),
    )


def _mean(stack: Stack) -> F64:
    return np.asarray(stack.readings[0].mean(axis=0, dtype=np.float64))


def _points(sweep: Sweep, dark: Dark, full: Full) -> _Points:
    good, rows = dark.good, []
    ceiling = full.reading_dn[good]
    for frames, exposure_s in zip(sweep.stacks, sweep.exposures_s, strict=True):
        check_stack_or_full(frames, full)
        pixels = frames[:, good].astype(np.float64)
        mean, levels = pixels.mean(axis=0), pixels.mean(axis=1)
        # The lamp's changes from frame to frame are common to all pixels: they are no noise of theirs.
        rest = pixels - mean - (levels - levels.mean())[:, None]
        freedom = (len(frames) - 1) * (mean.size - 1)
        variance = float(np.square(rest).sum()) / freedom
        near = float(np.quantile(mean - ceiling, BRIGHT_QUANTILE))
        signal = float((mean - dark.at(exposure_s)[good]).mean())
        charge = float((mean - dark.offset_dn[good]).mean())
        clear = near < -CLEAR_SIGMAS * np.sqrt(variance)
        rows.append((signal, charge, variance, freedom, float(levels.var(ddof=1)), len(frames), clear))
    signal, charge, variance, freedom, fluctuation, frames_taken, clear = np.array(rows).T
    time_s = sweep.times_s - sweep.times_s.mean()
    enough = np.asarray(clear > 0)
    points = _Points(
        sweep.exposures_s, time_s, signal, charge, variance, freedom, fluctuation, frames_taken, enough & (signal > 0)
    )
    if points.clear.sum() < LEAST_LEVELS:
        raise CalibrationError(
            STEP,
            Reason.SATURATED,
            f"{int(points.clear.sum())} of {len(rows)} levels are below saturation",
            allowed=f"{LEAST_LEVELS} or more",
            remedy="dim the lamp so that longer exposures fill the pixels",
        )
    return points


def check_stack_or_full(frames: F32, full: Full) -> None:
    """Accept live frames, or frames that are all the same because every pixel is at the converter's top.

    Raises:
        CalibrationError: As `gs2ci_calibration.frames.check_stack`.
    """
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
    # Errors of a level: its shot noise, and a share of 0.01 % for the lamp; their scale comes from the residuals.
    pixels = points.freedom[use] + points.frames[use] - 1
    sigma = np.hypot(np.sqrt(points.variance[use] / pixels), 1e-4 * signal)
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


def _departure(slope: float, square: float, full_dn: float) -> float:
    """Return d from signal = slope E + square E²: slope = c (1 + 4 d), square = −4 d c² / S."""
    departure = 0.0
    for _ in range(8):  # contracts by 8 d at each turn, which is below a half
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
        y, sigma = (variance - dark) / bent, variance / bent * np.sqrt(2 / freedom)
        weight = straight / np.square(sigma)
        total = float(weight @ straight)
        return float(weight @ y) / total, 1 / float(np.sqrt(total))

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
    """Return the dark noise in electrons, rounding taken off.

    Raises:
        CalibrationError: There is no more noise than rounding alone makes.
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


def _section(bench: Bench, found: SensorEstimate) -> Section:
    notes = [f"readings end at {found.saturation_dn[0]:.0f} DN, by the {found.limited_by}"]
    if found.limited_by == "converter":
        notes.append("the full well is larger than stated: the converter ends before it")
    return Section(
        name=STEP,
        estimates={
            "gain_e_per_dn": Estimate(*found.gain_e_per_dn, "e/DN"),
            "read_noise_e": Estimate(*found.read_noise_e, "e"),
            "full_well_e": Estimate(*found.full_well_e, "e"),
            "saturation_dn": Estimate(*found.saturation_dn, "DN"),
            "linearity_error": Estimate(*found.linearity_error, "1"),
            "linear_to_dn": Estimate(*found.linear_to_dn, "DN"),
        },
        arrays={
            "curve_signal_dn": found.signal_dn,
            "curve_variance_dn2": found.variance_dn2,
            "curve_exposure_s": found.exposures_s,
        },
        facts={
            "limited_by": found.limited_by,
            "flicker": found.flicker,
            "format": bench.devices.sensor.settings.format.fourcc,
            "top_dn": bench.top_dn,
            "gain_db": bench.config.gain_db,
        },
        notes=tuple(notes),
    )
