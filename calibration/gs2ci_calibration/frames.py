"""What every procedure asks of a stack of frames before it believes it, and robust means over its pixels.

Pure: arrays in, numbers out, `CalibrationError` where they are no good. Not here: taking frames (`bench`), the
procedures. For this package.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gs2ci_calibration.refusals import CalibrationError, Reason

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Flags = NDArray[np.bool_]

FLICKER_LIMIT: Final = 0.005
"""Largest rms change of the light from frame to frame, relative, beyond its own noise."""
DRIFT_LIMIT: Final = 0.03
"""Largest steady change of the light over one stack, relative."""
SIGNIFICANT: Final = 5.0
"""Standard errors from which on something is there: once in two million by chance."""
DEAD_SHARE: Final = 0.01
"""Most pixels that may be dead or hot."""
# Freedom of the prior that steadies a pixel's own variance by that of all pixels: with 32 frames both count alike.
PRIOR_FREEDOM: Final = 31.0
QUANTISATION_VARIANCE: Final = 1.0 / 12.0
"""Of rounding to whole DN (EMVA 1288, Release 3.1, section 2.2)."""


def check_stack(step: str, frames: F32, *, at_least: int = 2) -> None:
    """Accept frames [K, H, W] that are live readings of a sensor.

    Raises:
        CalibrationError: Too few, not finite, or all the same.
    """
    if frames.ndim != 3 or len(frames) < at_least:
        raise CalibrationError(
            step,
            Reason.TOO_FEW_FRAMES,
            f"{len(frames) if frames.ndim == 3 else 1} frame(s): one frame has no noise to be judged by",
            allowed=f"{at_least} or more",
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
            remedy="see whether the sensor repeats a frame, or clips everything at black: raise its black level",
        )


def mean_and_variance(frames: F32) -> tuple[F64, F64]:
    """Return each pixel's mean and the variance of one reading, [H, W] each.

    A pixel's own sample variance is steadied by the mean of all pixels', as by a conjugate prior of
    `PRIOR_FREEDOM`: a few frames then give no zero by chance.
    """
    stack = frames.astype(np.float64)
    freedom = len(stack) - 1
    own = stack.var(axis=0, ddof=1)
    common = trimmed_mean(own)
    return stack.mean(axis=0), (freedom * own + PRIOR_FREEDOM * common) / (freedom + PRIOR_FREEDOM)


def trimmed_mean(values: F64, share: float = 0.01) -> float:
    """Return the mean without the highest share of the values: hot pixels do not count."""
    flat = np.sort(values, axis=None)
    return float(flat[: max(int(np.ceil(flat.size * (1 - share))), 1)].mean())


def rounding_bias_dn(noise_dn: float) -> float:
    """Return by how much rounding biases the mean of readings with this noise, rms over all phases, DN.

    The characteristic function of the noise at one cycle per DN, over pi: large only when noise is far below a DN
    (Widrow and Kollar, Quantization Noise, 2008, section 4).
    """
    return float(np.exp(-2 * np.square(np.pi * noise_dn)) / (np.pi * np.sqrt(2)))


@dataclass(frozen=True)
class Lamp:
    """How steady the light was over a stack, beyond the noise of the readings.

    Args:
        flicker: Rms change from frame to frame, relative.
        drift: Steady change over the stack, relative.
        flicker_error: Standard error of the rms, from the number of frames.
    """

    flicker: float
    drift: float
    flicker_error: float


def judge_lamp(step: str, frames: F32, dark: F64) -> Lamp:
    """Return how steady the light was over frames [K, H, W] with the given dark level [H, W].

    Raises:
        CalibrationError: It flickers or drifts by more than the limits.
    """
    signal = frames.astype(np.float64) - dark
    levels = signal.mean(axis=(1, 2))
    mean = float(levels.mean())
    time = np.linspace(-0.5, 0.5, len(levels))
    slope = float(time @ levels / (time @ time))
    rest = levels - mean - slope * time
    freedom = max(len(levels) - 2, 1)
    noise = float(signal.var(axis=0, ddof=1).mean()) / signal[0].size
    excess = max(float(rest @ rest) / freedom - noise, 0.0)
    flicker = float(np.sqrt(excess)) / mean
    error = float(np.sqrt((noise + excess) / freedom)) / mean
    lamp = Lamp(flicker, slope / mean, error)
    # A pair of frames cannot tell drift from flicker.
    if flicker - 2 * error / np.sqrt(2) > FLICKER_LIMIT or (len(levels) > 2 and flicker > 3 * FLICKER_LIMIT):
        raise CalibrationError(
            step,
            Reason.LAMP_FLICKERS,
            f"the light changes by {100 * flicker:.2f} % rms from frame to frame",
            allowed=f"at most {100 * FLICKER_LIMIT:.1f} %",
            remedy="use a lamp on direct current, or exposures of whole periods of the mains",
        )
    if abs(lamp.drift) > DRIFT_LIMIT:
        raise CalibrationError(
            step,
            Reason.LAMP_DRIFTS,
            f"the light changed by {100 * lamp.drift:.1f} % over {len(levels)} frames",
            allowed=f"at most {100 * DRIFT_LIMIT:.0f} %",
            remedy="let the lamp warm up",
        )
    return lamp


def check_dead(step: str, dead: Flags) -> None:
    """Accept a map of dead pixels [H, W].

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
            f"{int(dead.sum())} pixels ({100 * share:.2f} %) do not answer to light"
            + (f", all of {' and '.join(lines)}" if lines else ""),
            allowed=f"at most {100 * DEAD_SHARE:.0f} %, no whole row or column",
            remedy="crop the sensor in [sensor], clean it, or look for what shades it",
        )
