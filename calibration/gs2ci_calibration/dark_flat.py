"""Dark and flat frames: each pixel's offset, dark current, temporal noise and response, and which pixels are bad.

Here: the procedure `measure` and its pure estimators. Not here: electrons (`photon_transfer`), masks. Terms and figures
of merit are those of EMVA Standard 1288, Release 3.1, sections 2 to 4.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from gs2ci.core.arrays import F32, F64, U8, Bool
from gs2ci_calibration.bench import Arrangement, Bench, Stack
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.exposing import Level, find_exposure, limits_s
from gs2ci_calibration.frames import (
    PRIOR_FREEDOM,
    SIGNIFICANT,
    Dark,
    by_colour,
    check_dead,
    check_lamp,
    check_stack,
    mean_and_variance,
    mean_error,
    root,
    rounding_bias_dn,
    trimmed_mean,
)
from gs2ci_calibration.refusals import CalibrationError, Reason

STEP: Final = "dark-flat"
FLAT_SHARE: Final = 0.5
"""Share of the range that the flat field fills: EMVA 1288 measures the response there."""
LEAST_LONG_S: Final = 1.0
"""The long dark exposure is at least this long, if the devices can: dark current is small."""
MIDDLE_SHARE: Final = 0.125
"""The middle dark exposure over the long one: for pixels that overflow in the long one, the middle one is used."""
STRAY_SHARE: Final = 0.25
"""Largest light in the dark frames, in standard deviations of a pixel's noise."""
DARK_FILL: Final = 0.5
"""Largest share of the range that dark frames may fill."""
BLACK_SHARE: Final = 0.01
"""Largest share of dark readings that may be 0: with more of them, the noise is clipped."""
HOT_SIGMAS: Final = 6.0
"""A pixel is hot if its dark current exceeds the others' by this many of their standard deviations."""
HOT_SHARE: Final = 0.05
LOW_RESPONSE: Final = 0.1
"""A pixel below this share of the median response is dead."""
UNEVEN_LIMIT: Final = 0.3
"""Smallest response of the dimmer pixels over the median."""
SMOOTH_DEGREE: Final = 4
"""Degree of the polynomial in row and column that is subtracted from a map before its spread is computed: the light's
fall-off is no PRNU (EMVA 1288 removes it by a high-pass filter; near the border of a small field a polynomial is
better)."""


def measure(bench: Bench, known: Bundle) -> Section:
    """Take dark and flat frames and return the section `dark-flat`; `known` is not used.

    Raises:
        CalibrationError: Stray light, frames without variation, light that is uneven, unsteady, too strong or too
            weak, too many bad pixels.
        DriverError: A device failed.
    """
    darks = _take_darks(bench)
    found = estimate_dark(darks, bench.top_dn)
    bench.please(Arrangement.FLAT)
    bench.progress.stage("flat frames", bench.options.frames)
    level = find_exposure(bench, STEP, found.dark, FLAT_SHARE)
    open_pattern = bench.flat_pattern(is_open=True)[None]
    flat = bench.grab(open_pattern, frames=bench.options.frames, exposure_s=level.exposure_s)
    bench.progress.step(bench.options.frames, mean_dn=float(flat.readings.mean()), exposure_ms=1e3 * level.exposure_s)
    mosaic = bench.devices.sensor.settings.format.cfa is not None
    response = estimate_response(flat.readings[0], flat.exposure_s, found, mosaic=mosaic)
    return _section(bench, darks, found, response, level)


@dataclass(frozen=True)
class Darks:
    """Dark frames: at a short, a middle and a long exposure, and long ones with an open modulator.

    Args:
        short: [K, H, W] DN.
        middle: [K, H, W].
        long: [K, H, W].
        unshut: [K, H, W], as `long`, with all mirrors on.
        exposures_s: Exposures of the first three.
    """

    short: F32
    middle: F32
    long: F32
    unshut: F32
    exposures_s: tuple[float, float, float]


@dataclass(frozen=True)
class DarkEstimate:
    """The estimates from dark frames.

    Args:
        dark: Offset, current and hot pixels; no pixel counts as dead yet.
        offset_error_dn: Standard errors of the offset, [H, W].
        current_error_dn_per_s: Standard errors of the current, [H, W].
        noise_dn: Temporal noise at the short exposure, [H, W].
        noise_error_dn: Its standard errors, [H, W].
        noise_rms_dn: Its rms over all pixels that are not hot, with its standard error.
        dsnu_dn: Spread of the offsets, with its standard error.
        means_dn2: Variance of the means of the short and of the long frames, mean over the pixels that are not hot.
        exposures_s: Exposures of these.
    """

    dark: Dark
    offset_error_dn: F64
    current_error_dn_per_s: F64
    noise_dn: F64
    noise_error_dn: F64
    noise_rms_dn: tuple[float, float]
    dsnu_dn: tuple[float, float]
    means_dn2: tuple[float, float]
    exposures_s: tuple[float, float]


@dataclass(frozen=True)
class ResponseEstimate:
    """The estimates from flat frames.

    Args:
        response: Sensitivity over the mean one, fall-off of the light included, [H, W]; 1 at dead pixels.
        error: Its standard errors, [H, W]; 1 at dead pixels.
        dead: Pixels that do not respond to light, [H, W].
        rate_dn_per_s: How fast the mean pixel fills, with its standard error.
        prnu: Spread of the response between neighbours, of the same colour on a mosaic, with its standard error.
        flicker: Relative flicker of the lamp.
    """

    response: F64
    error: F64
    dead: Bool
    rate_dn_per_s: tuple[float, float]
    prnu: tuple[float, float]
    flicker: float


def estimate_dark(darks: Darks, top_dn: int) -> DarkEstimate:
    """Estimate offset, dark current and noise of each pixel.

    Args:
        darks: The frames.
        top_dn: Largest reading.

    Raises:
        CalibrationError: Too few frames, frames all the same, readings clipped at black, stray light, or too many hot
            pixels.
    """
    for frames in (darks.short, darks.middle, darks.long, darks.unshut):
        check_stack(STEP, frames)
    _check_black(darks, top_dn)
    _check_shut(darks)
    short, short_variance = mean_and_variance(darks.short)
    current, current_error, full = _currents(darks, top_dn)
    short_s, noise = darks.exposures_s[0], np.sqrt(short_variance)
    hot = _hot(current, current_error) | full
    dark = Dark(short - current * short_s, current, np.zeros(short.shape, np.bool_), hot)
    offset_error = np.hypot(_error(darks.short), current_error * short_s)
    own = darks.short.astype(np.float64).var(axis=0, ddof=1)
    means_dn2 = (_square_error(darks.short, ~hot), _square_error(darks.long, ~hot))
    exposures_s = (short_s, darks.exposures_s[2])
    offset_noise = np.full(short.shape, _dark_square_error(means_dn2, exposures_s, 0.0))
    return DarkEstimate(
        dark,
        offset_error,
        current_error,
        noise,
        _noise_error(noise, len(darks.short) - 1),
        _pooled(own[~hot], len(darks.short) - 1),
        _spread(dark.offset_dn, offset_noise, ~hot, len(darks.short) - 1),
        means_dn2,
        exposures_s,
    )


def estimate_response(flat: F32, exposure_s: float, found: DarkEstimate, *, mosaic: bool = False) -> ResponseEstimate:
    """Estimate each pixel's response to even light.

    Args:
        flat: Frames of the flat field, [K, H, W] DN.
        exposure_s: Exposure of each frame.
        found: The estimates from the dark frames.
        mosaic: Whether pixels stand behind a colour filter array: its colours are no PRNU.

    Raises:
        CalibrationError: Too few frames, or all the same; the lamp is off, unsteady or uneven; too many dead pixels.
    """
    check_stack(STEP, flat)
    level_dark = found.dark.at(exposure_s)
    lamp = check_lamp(STEP, flat, level_dark)
    signal = flat.astype(np.float64) - level_dark
    # Changes of the lamp are common to all pixels and do not count as their noise.
    levels = np.median(signal, axis=(1, 2))
    steadied = (signal * (levels.mean() / levels)[:, None, None]).astype(np.float32)
    mean, variance = mean_and_variance(steadied)
    dark_error = np.hypot(found.offset_error_dn, found.current_error_dn_per_s * exposure_s)
    error = np.hypot(mean_error(variance, len(flat)), dark_error)
    middle = by_colour(mean, np.ones(mean.shape, np.bool_), np.median) if mosaic else np.median(mean)
    dead = (mean < SIGNIFICANT * error) | (mean < LOW_RESPONSE * middle)
    check_dead(STEP, dead)
    typical = float(mean[~dead].mean())
    # Over the mean of its colour: the lamp, not the pixel, makes one colour darker than another.
    level = by_colour(mean, ~dead, np.mean) if mosaic else np.full(mean.shape, typical)
    even = mean / level
    low = float(np.quantile(even[~dead], 0.02))
    if low < UNEVEN_LIMIT:
        whose = "their colour's" if mosaic else "its"
        raise CalibrationError(
            STEP,
            Reason.UNEVEN,
            f"the dimmer pixels of the flat field have {100 * low:.0f} % of {whose} mean",
            allowed=f"{100 * UNEVEN_LIMIT:.0f} % or more",
            remedy="light the field evenly: opal glass close to the lens, or an integrating sphere",
        )
    response = np.where(dead, 1.0, mean / typical)
    relative = error / typical
    noise = steadied.var(axis=0, ddof=1, dtype=np.float64) / len(flat)
    noise += _dark_square_error(found.means_dn2, found.exposures_s, exposure_s)
    rate_error = np.hypot(float(dark_error.mean()), typical * lamp.flicker / np.sqrt(len(flat)))
    shot_error = float(np.sqrt(trimmed_mean(variance) / flat.size))
    return ResponseEstimate(
        response,
        np.where(dead, 1.0, relative),
        dead,
        (typical / exposure_s, float(np.hypot(rate_error, shot_error)) / exposure_s),
        _spread(even, noise / np.square(level), ~(dead | found.dark.hot), len(flat) - 1),
        lamp.flicker,
    )


def _take_darks(bench: Bench) -> Darks:
    """Take all dark frames; if the devices can, their exposures span the capture's exposure."""
    bench.please(Arrangement.DARK)
    frames = bench.options.frames
    few = max(frames // 4, 2)
    shortest_s, longest_s = limits_s(bench)
    capture_s = len(bench.capture.masks) * bench.capture.mask_s
    long_s = min(max(LEAST_LONG_S, 2 * capture_s), longest_s)
    shut, unshut = (bench.flat_pattern(is_open=is_open)[None] for is_open in (False, True))

    bench.progress.stage("dark frames", 2 * (frames + few))
    taken = 0

    def take(pattern: U8, count: int, exposure_s: float) -> Stack:
        nonlocal taken
        stack = bench.grab(pattern, frames=count, exposure_s=exposure_s)
        taken += count
        bench.progress.step(taken, mean_dn=float(stack.readings.mean()), exposure_ms=1e3 * exposure_s)
        return stack

    short = take(shut, frames, shortest_s)
    middle = take(shut, few, max(MIDDLE_SHARE * long_s, 2 * shortest_s))
    long = take(shut, frames, long_s)
    lit = take(unshut, few, long_s)
    return Darks(
        short.readings[0],
        middle.readings[0],
        long.readings[0],
        lit.readings[0],
        (short.exposure_s, middle.exposure_s, long.exposure_s),
    )


def _check_black(darks: Darks, top_dn: int) -> None:
    share = float((darks.short == 0).mean())
    if share > BLACK_SHARE:
        raise CalibrationError(
            STEP,
            Reason.CLIPPED_AT_BLACK,
            f"{100 * share:.0f} % of the dark readings are 0: half of the noise is cut off",
            allowed=f"at most {100 * BLACK_SHARE:.0f} %",
            remedy="raise the sensor's black level",
        )
    filled = float(np.median(darks.long)) / top_dn
    if filled > DARK_FILL:
        raise CalibrationError(
            STEP,
            Reason.NOT_DARK,
            f"dark frames of {darks.exposures_s[2]:.3g} s fill {100 * filled:.0f} % of the range",
            allowed=f"at most {100 * DARK_FILL:.0f} %",
            remedy="put the lens cap on; if it is on, cool the sensor",
        )


def _check_shut(darks: Darks) -> None:
    """Check that dark frames do not change when the modulator opens."""
    change = float(np.median(darks.unshut.mean(axis=0, dtype=np.float64) - darks.long.mean(axis=0, dtype=np.float64)))
    noise = float(np.sqrt(trimmed_mean(darks.long.astype(np.float64).var(axis=0, ddof=1))))
    # The median of many pixels' means: its error is 1.25 of the mean's.
    error = 1.25 * noise * np.sqrt(1 / darks.unshut.size + 1 / darks.long.size)
    if change > max(SIGNIFICANT * error, STRAY_SHARE * noise):
        raise CalibrationError(
            STEP,
            Reason.NOT_DARK,
            f"dark frames of {darks.exposures_s[2]:.3g} s gain {change:.2f} DN when the modulator opens",
            allowed=f"at most {max(SIGNIFICANT * error, STRAY_SHARE * noise):.2f} DN",
            remedy="put the lens cap on",
        )


def _currents(darks: Darks, top_dn: int) -> tuple[F64, F64, Bool]:
    """Return each pixel's dark current, its standard error, and whether the pixel is full after the long exposure."""
    short_s, middle_s, long_s = darks.exposures_s
    stacks = (darks.short, darks.middle, darks.long)
    short, middle, long = (mean_and_variance(frames)[0] for frames in stacks)
    short_error, middle_error, long_error = (_error(frames) for frames in stacks)
    # A pixel that overflows in the long exposure does not reach the reading predicted from the middle one.
    times = (long_s - short_s) / (middle_s - short_s)
    foretold = short + (middle - short) * times
    doubt = np.hypot(np.hypot(middle_error, short_error) * times, long_error)
    full: Bool = (long - foretold < -SIGNIFICANT * doubt) | (darks.long == top_dn).any(axis=0)
    span_s = np.where(full, middle_s, long_s) - short_s
    current = np.where(full, middle - short, long - short) / span_s
    return current, np.hypot(np.where(full, middle_error, long_error), short_error) / span_s, full


def _error(frames: F32) -> F64:
    """Return the standard error of each pixel's mean; in noisy readings the part from rounding is small."""
    _, variance = mean_and_variance(frames)
    return np.hypot(mean_error(variance, len(frames)), rounding_bias_dn(float(np.sqrt(trimmed_mean(variance)))))


def _square_error(frames: F32, good: Bool) -> float:
    """Return the variance of the pixels' means, mean over the good pixels, DN squared.

    A mean over pixels needs neither a prior nor Student's law, by which the error of each pixel's mean is stated.
    """
    own = frames.astype(np.float64).var(axis=0, ddof=1)[good].mean()
    return float(own / len(frames) + rounding_bias_dn(float(np.sqrt(own))) ** 2)


def _dark_square_error(means_dn2: tuple[float, float], exposures_s: tuple[float, float], exposure_s: float) -> float:
    """Return the variance of the line through the means at the short and the long exposure, DN squared."""
    share = (exposure_s - exposures_s[0]) / (exposures_s[1] - exposures_s[0])
    return (1 - share) ** 2 * means_dn2[0] + share**2 * means_dn2[1]


def _hot(current: F64, error: F64) -> Bool:
    typical = float(np.median(current))
    spread = 1.4826 * float(np.median(np.abs(current - typical)))  # standard deviation of a normal law, by its MAD
    hot: Bool = current - typical > np.maximum(HOT_SIGMAS * spread, SIGNIFICANT * error)
    share = float(hot.mean())
    if share > HOT_SHARE:
        raise CalibrationError(
            STEP,
            Reason.DEAD_PIXELS,
            f"{100 * share:.1f} % of the pixels have far more dark current than the others",
            allowed=f"at most {100 * HOT_SHARE:.0f} %",
            remedy="cool the sensor, or look for light that leaks in beside the lens",
        )
    return hot


def _noise_error(noise: F64, freedom: int) -> F64:
    """Return the standard error of each pixel's noise; noise that is low by chance is not taken as more precise."""
    steadied = np.sqrt(0.5 * (np.square(noise) + trimmed_mean(np.square(noise))))
    return steadied * np.sqrt(freedom / 2) / (freedom + PRIOR_FREEDOM)


def _pooled(variances: F64, freedom: int) -> tuple[float, float]:
    mean = float(variances.mean())
    return root(mean, mean * float(np.sqrt(2 / (variances.size * freedom))))


def _spread(values: F64, noise: F64, good: Bool, noise_freedom: int) -> tuple[float, float]:
    """Return the standard deviation of a map between neighbours, less its noise, with its standard error.

    Args:
        values: The map, [H, W].
        noise: Unbiased estimates of its variance by noise, [H, W].
        good: Pixels that count, [H, W].
        noise_freedom: Degrees of freedom of each pixel's estimate.
    """
    rows, columns = (np.linspace(-1, 1, side) for side in values.shape)
    terms = np.polynomial.legendre.legvander2d(*np.meshgrid(rows, columns, indexing="ij"), [SMOOTH_DEGREE] * 2)[good]
    # Normal equations: Legendre's polynomials are nearly orthogonal over a field, so squaring loses no precision.
    smooth = np.linalg.solve(terms.T @ terms, terms.T @ values[good])
    freedom = max(len(terms) - terms.shape[1], 1)
    total = float(np.square(values[good] - terms @ smooth).sum()) / freedom
    mean_noise = float(noise[good].mean())
    return root(total - mean_noise, float(np.sqrt(2 / freedom) * np.hypot(total, mean_noise / np.sqrt(noise_freedom))))


def _section(bench: Bench, darks: Darks, found: DarkEstimate, response: ResponseEstimate, level: Level) -> Section:
    dark = replace(found.dark, dead=response.dead)
    hot, dead = int(dark.hot.sum()), int(dark.dead.sum())
    return Section(
        name=STEP,
        estimates={
            "offset_dn": Estimate(_f4(dark.offset_dn), _f4(found.offset_error_dn), "DN"),
            "dark_current_dn_per_s": Estimate(_f4(dark.current_dn_per_s), _f4(found.current_error_dn_per_s), "DN/s"),
            "dark_noise_dn": Estimate(_f4(found.noise_dn), _f4(found.noise_error_dn), "DN"),
            "response": Estimate(_f4(response.response), _f4(response.error), "1"),
            "dark_noise_rms_dn": Estimate(*found.noise_rms_dn, "DN"),
            "dsnu_dn": Estimate(*found.dsnu_dn, "DN"),
            "prnu": Estimate(*response.prnu, "1"),
            "flat_dn_per_s": Estimate(*response.rate_dn_per_s, "DN/s"),
        },
        arrays={"hot": dark.hot.astype(np.uint8), "dead": dark.dead.astype(np.uint8)},
        facts={
            "frames": bench.options.frames,
            "dark_exposures_s": list(darks.exposures_s),
            "flat_exposure_s": level.exposure_s,
            "flicker": response.flicker,
            "format": bench.devices.sensor.settings.format.fourcc,
            "region": bench.region,
            "top_dn": bench.top_dn,
            "gain_db": bench.config.gain_db,
        },
        notes=(f"{hot} hot and {dead} dead pixels of {dark.hot.size}",),
    )


def _f4(values: F64) -> F32:
    return values.astype(np.float32)
