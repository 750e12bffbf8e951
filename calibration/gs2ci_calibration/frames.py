"""Checks that every stack of frames must pass before it is used, and means over its pixels and frames.

Pure: arrays in, numbers out, `CalibrationError` if the frames cannot be used. Not here: taking frames (`bench`), the
procedures.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci_calibration.estimates import Section
from gs2ci_calibration.refusals import CalibrationError, Reason

FLICKER_LIMIT: Final = 0.005
"""Largest rms change of the light from frame to frame, relative, beyond its own noise."""
DRIFT_LIMIT: Final = 0.03
"""Largest steady change of the light over one stack, relative."""
SIGNIFICANT: Final = 5.0
"""Number of standard errors from which on an effect counts as real: exceeded by chance once in two million."""
DEAD_SHARE: Final = 0.01
"""Largest share of dead pixels."""
PRIOR_FREEDOM: Final = 4.0
"""Degrees of freedom of the prior that pulls a pixel's variance towards the mean: it matters only with few frames."""
QUANTISATION_VARIANCE: Final = 1.0 / 12.0
"""Variance of rounding to whole DN (EMVA 1288, Release 3.1, section 2.2)."""


@dataclass(frozen=True)
class Dark:
    """The sensor's readings without light.

    Args:
        offset_dn: Reading at zero exposure, [H, W].
        current_dn_per_s: Its increase per second, [H, W].
        dead: Pixels that do not respond to light, [H, W].
        hot: Pixels with far more dark current than the others, [H, W].
    """

    offset_dn: F64
    current_dn_per_s: F64
    dead: Bool
    hot: Bool

    @classmethod
    def of(cls, section: Section) -> Self:
        """Return the values of the section `dark-flat`."""
        return cls(
            section.array("offset_dn").astype(np.float64),
            section.array("dark_current_dn_per_s").astype(np.float64),
            section.array("dead") > 0,
            section.array("hot") > 0,
        )

    @property
    def good(self) -> Bool:
        """Get the pixels that are neither dead nor hot, [H, W]."""
        return ~(self.dead | self.hot)

    def at(self, exposure_s: float) -> F64:
        """Return the mean reading without light after an exposure, [H, W] DN."""
        return self.offset_dn + self.current_dn_per_s * exposure_s


def check_stack(step: str, frames: F32) -> None:
    """Check that frames [K, H, W] are live readings of a sensor.

    Raises:
        CalibrationError: Too few, not finite, or all the same.
    """
    if frames.ndim != 3 or len(frames) < 2:
        raise CalibrationError(
            step,
            Reason.TOO_FEW_FRAMES,
            f"{len(frames) if frames.ndim == 3 else 1} frame(s): noise cannot be estimated from one frame",
            allowed="2 or more",
            remedy="raise `frames` in [calibration]",
        )
    if not np.isfinite(frames).all():
        raise CalibrationError(step, Reason.DEAD_PIXELS, "frames hold values that are not finite")
    if not (frames != frames[0]).any():
        raise CalibrationError(
            step,
            Reason.NO_VARIANCE,
            f"all {len(frames)} frames are the same, bit for bit",
            allowed="live readings, which differ by their noise",
            remedy="check whether the sensor repeats a frame, or clips everything at black: raise its black level, or "
            "read it with more bits",
        )


def mean_and_variance(frames: F32) -> tuple[F64, F64]:
    """Return each pixel's mean and the variance of one reading, [H, W] each.

    A pixel's own sample variance is combined with the mean of all pixels', as by a conjugate prior with
    `PRIOR_FREEDOM` degrees of freedom, so that few frames do not give a variance of zero by chance.
    """
    stack = frames.astype(np.float64)
    freedom = len(stack) - 1
    own = stack.var(axis=0, ddof=1)
    common = trimmed_mean(own)
    return stack.mean(axis=0), (freedom * own + PRIOR_FREEDOM * common) / (freedom + PRIOR_FREEDOM)


def mean_error(variance: F64, frames: int) -> F64:
    """Return the standard error of means over `frames` frames, from variances of `mean_and_variance`.

    If the variance was itself estimated with f degrees of freedom, the mean follows Student's law, whose variance is
    larger by f / (f − 2).
    """
    freedom = frames - 1 + PRIOR_FREEDOM
    return np.sqrt(variance / frames * freedom / (freedom - 2))


def noise_variance(pixels: F64, lit: F64) -> tuple[float, float]:
    """Return the variance of one reading by noise, mean over the pixels, and its degrees of freedom.

    The lamp's changes from frame to frame are common to all pixels, in proportion to their light, and do not count as
    noise. On a mosaic, or under uneven light, a constant subtracted from all pixels would leave part of them.

    Args:
        pixels: Readings, [K, P] DN, K of 2 or more.
        lit: The mean reading of each above dark, [P] DN.
    """
    levels, mean = pixels.mean(axis=1), float(lit.mean())
    share = lit / mean if mean > 0 else np.ones_like(lit)
    rest = pixels - pixels.mean(axis=0) - (levels - levels.mean())[:, None] * share
    freedom = (len(pixels) - 1) * (pixels.shape[1] - 1)
    return float(np.square(rest).sum()) / freedom, float(freedom)


def trimmed_mean(values: F64) -> float:
    """Return the mean without the highest percent of the values, which excludes hot pixels."""
    flat = np.sort(values, axis=None)
    return float(flat[: max(int(np.ceil(flat.size * 0.99)), 1)].mean())


def by_colour(values: F64, good: Bool, statistic: Callable[[F64], float]) -> F64:
    """Return for each pixel, [H, W], a statistic of the good ones in its place of a mosaic's 2 x 2 pattern.

    Args:
        values: Of the pixels, [H, W].
        good: Pixels that count, [H, W].
        statistic: Of the values of some pixels, [K].
    """
    found = np.empty_like(values)
    for row, column in np.ndindex(2, 2):
        phase = np.s_[row::2, column::2]
        found[phase] = statistic(values[phase][good[phase]])
    return found


def rounding_bias_dn(noise_dn: float) -> float:
    """Return the bias that rounding causes in the mean of readings with this noise, rms over all phases, DN.

    It is the characteristic function of the noise at one cycle per DN, over pi: large only if the noise is far below a
    DN (Widrow and Kollar, Quantization Noise, 2008, section 4).
    """
    return float(np.exp(-2 * np.square(np.pi * noise_dn)) / (np.pi * np.sqrt(2)))


def rounding_variance_bias(noise_dn: float, levels_dn: F64) -> float:
    """Return the largest possible difference between the variance of rounded readings and the noise's plus 1/12 DN².

    For one pixel it is (4 σ² + 1/π²) exp(−2 π² σ²) cos(2 π level); if levels differ from pixel to pixel, most of it
    cancels in the mean over pixels (Widrow and Kollar, as above).
    """
    largest = (4 * noise_dn**2 + 1 / np.pi**2) * float(np.exp(-2 * np.square(np.pi * noise_dn)))
    return largest * float(np.abs(np.exp(2j * np.pi * levels_dn).mean()))


def root(variance: float, error: float) -> tuple[float, float]:
    """Return a standard deviation and its standard error from an estimated variance, which may be below 0 by chance.

    Near 0 the error of the root follows from the error of the variance: σ² = 0 ± e means σ < √e. If the variance is
    within two of its errors of 0, the deviation is within two of its own errors of 0.
    """
    if variance <= 0:
        return 0.0, float(np.sqrt(error))
    sigma = float(np.sqrt(variance))
    at_least = sigma / 2 if variance < 2 * error else 0.0
    return sigma, float(max(min(error / (2 * sigma), np.sqrt(error)), at_least))


@dataclass(frozen=True)
class Lamp:
    """Unsteadiness of the light over a stack, beyond the noise of the readings.

    Args:
        flicker: Rms change from frame to frame, relative.
        drift: Steady change over the stack, relative.
    """

    flicker: float
    drift: float


def check_lamp(step: str, frames: F32, dark: F64) -> Lamp:
    """Return the unsteadiness of the light over frames [K, H, W], K of 3 or more, with the given dark level [H, W].

    Raises:
        CalibrationError: No light, or it flickers or drifts by more than the limits.
    """
    signal = frames.astype(np.float64) - dark
    levels = signal.mean(axis=(1, 2))
    mean = float(levels.mean())
    if mean <= 0:
        refuse_dark(step, mean)
    time = np.linspace(-0.5, 0.5, len(levels))
    slope = float(time @ levels / (time @ time))
    rest = levels - mean - slope * time
    freedom = max(len(levels) - 2, 1)
    noise = float(signal.var(axis=0, ddof=1).mean()) / signal[0].size
    excess = max(float(rest @ rest) / freedom - noise, 0.0)
    flicker = float(np.sqrt(excess)) / mean
    error = float(np.sqrt((noise + excess) / (2 * freedom))) / mean
    check_flicker(step, flicker, error)
    check_drift(step, slope / mean, len(levels))
    return Lamp(flicker, slope / mean)


def refuse_dark(step: str, signal_dn: float) -> None:
    """Refuse a field that is no brighter than the dark frames.

    Raises:
        CalibrationError: Always.
    """
    raise CalibrationError(
        step,
        Reason.NO_LIGHT,
        f"the field is {signal_dn:.2f} DN above the dark frames",
        remedy="take the lens cap off, switch the lamp on, check that the modulator lets light through",
    )


def check_flicker(step: str, flicker: float, error: float) -> None:
    """Check a relative rms change of the light from frame to frame, given with its standard error.

    Raises:
        CalibrationError: It is significantly above the limit.
    """
    if flicker - 2 * error > FLICKER_LIMIT:
        raise CalibrationError(
            step,
            Reason.LAMP_FLICKERS,
            f"the light changes by {100 * flicker:.2f} % rms from frame to frame",
            allowed=f"at most {100 * FLICKER_LIMIT:.1f} %",
            remedy="use a lamp on direct current, or exposures of whole periods of the mains",
        )


def check_drift(step: str, drift: float, frames: int) -> None:
    """Check a relative steady change of the light over some frames.

    Raises:
        CalibrationError: It is above the limit.
    """
    if abs(drift) > DRIFT_LIMIT:
        raise CalibrationError(
            step,
            Reason.LAMP_DRIFTS,
            f"the light changed by {100 * drift:.1f} % over {frames} frames",
            allowed=f"at most {100 * DRIFT_LIMIT:.0f} %",
            remedy="let the lamp warm up",
        )


def check_dead(step: str, dead: Bool) -> None:
    """Check a map of dead pixels [H, W].

    Raises:
        CalibrationError: A whole row or column is dead, or too many pixels are.
    """
    rows, columns = np.flatnonzero(dead.all(axis=1)), np.flatnonzero(dead.all(axis=0))
    share = float(dead.mean())
    if rows.size or columns.size or share > DEAD_SHARE:
        lines = [f"row {rows[0]}"] if rows.size else []
        lines += [f"column {columns[0]}"] if columns.size else []
        raise CalibrationError(
            step,
            Reason.DEAD_PIXELS,
            f"{int(dead.sum())} pixels ({100 * share:.2f} %) do not respond to light"
            + (f", all of {' and '.join(lines)}" if lines else ""),
            allowed=f"at most {100 * DEAD_SHARE:.0f} %, no whole row or column",
            remedy="crop the sensor in [sensor], clean it, or look for what shades it",
        )
