"""The flat field with every mirror on and with every mirror off: what all shares of light are measured against.

Here: the two references, the pixels that can be trusted, and the refusal of fields that are no good. Not here: the
lamp's drift between frames (`lamp`), masks (`masks`). For this package.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci_calibration.refusals import CalibrationError, Reason

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Fewest frames of each reference: from one alone no noise can be told.
FRAMES_MIN: Final = 2
# Saturated pixels (share of the field) from which on the field is refused rather than the pixels.
SATURATED_SHARE_MAX: Final = 0.01
# A pixel is blind when the mirrors change it by less than this share of what they change in the median pixel.
BLIND_BELOW: Final = 0.05
BLIND_SHARE_MAX: Final = 0.25
# Standard deviations by which light must rise above darkness, and on above off, in the median pixel.
SIGNAL_SIGMA: Final = 5.0
# Contrast below which masks could not be told from leakage at any price.
ON_OVER_OFF_MIN: Final = 1.5


@dataclass(frozen=True)
class References:
    """The references, in DN above dark.

    Args:
        on: Every mirror on, [H, W].
        off: Every mirror off, [H, W].
        valid: Pixels that see the mirrors switch and do not saturate, [H, W].
        noise_dn: Temporal noise of one frame with every mirror on, in the median pixel.
    """

    on: F64
    off: F64
    valid: Bools
    noise_dn: float

    @property
    def leakage(self) -> F64:
        """Get off / on, the contrast map, [H, W] in [0, 1]; 0 at pixels that are not valid."""
        return np.where(self.valid, np.clip(self.off / np.where(self.valid, self.on, 1.0), 0.0, 1.0), 0.0)

    def shares(self, above_dark: NDArray[np.floating]) -> F64:
        """Return (frame - off) / (on - off) of frames above dark [..., H, W]; 0 at pixels that are not valid."""
        swing = np.where(self.valid, self.on - self.off, 1.0)
        return np.where(self.valid, (above_dark - self.off) / swing, 0.0)

    def blind_rows(self) -> tuple[int, ...]:
        """Return the rows without a single valid pixel."""
        return tuple(int(row) for row in np.flatnonzero(~self.valid.any(axis=1)))

    def blind_columns(self) -> tuple[int, ...]:
        """Return the columns without a single valid pixel."""
        return tuple(int(column) for column in np.flatnonzero(~self.valid.any(axis=0)))


def judge(
    on_frames: NDArray[Any], off_frames: NDArray[Any], dark: NDArray[np.floating], *, saturation_dn: float
) -> References:
    """Average the references and refuse a field on which masks cannot be measured.

    Args:
        on_frames: Raw frames with every mirror on, [F, H, W] DN, F at least 2.
        off_frames: With every mirror off, [F, H, W], F at least 2.
        dark: Reading without light at this exposure, [H, W] or a number, DN.
        saturation_dn: Reading from which on a pixel may be clipped.

    Raises:
        CalibrationError: A single frame; saturated; no light (lens cap, lamp); the mirrors change nothing; on is
            darker than off (polarity); contrast too low; too many blind pixels.
    """
    procedure = "masks"
    for what, frames in (("on", on_frames), ("off", off_frames)):
        if frames.ndim != 3 or len(frames) < FRAMES_MIN:
            count = len(frames) if frames.ndim == 3 else 0
            raise CalibrationError(
                procedure,
                Reason.TOO_FEW_FRAMES,
                f"{count} frames with every mirror {what}",
                allowed=f"at least {FRAMES_MIN}: one alone tells nothing of the noise",
            )
    clipped = np.mean(on_frames >= saturation_dn, axis=0) > 0
    if clipped.mean() > SATURATED_SHARE_MAX:
        raise CalibrationError(
            procedure,
            Reason.SATURATED,
            f"{clipped.mean():.1%} of the pixels saturate with every mirror on",
            allowed=f"at most {SATURATED_SHARE_MAX:.0%}",
            remedy="shorten mask_s, dim the lamp or close the aperture until the flat field reads 50 to 80 % of full",
        )
    on = on_frames.mean(axis=0, dtype=np.float64) - dark
    off = off_frames.mean(axis=0, dtype=np.float64) - dark
    noise = _temporal_noise_dn(on_frames)
    _require_switching_light(on, off, noise / np.sqrt(min(len(on_frames), len(off_frames))), procedure)
    swing = on - off
    valid = (swing > BLIND_BELOW * float(np.median(swing[swing > 0]))) & ~clipped & (on > 0)
    if (~valid).mean() > BLIND_SHARE_MAX:
        raise CalibrationError(
            procedure,
            Reason.DEAD_PIXELS,
            f"{(~valid).mean():.1%} of the pixels do not see the mirrors switch",
            allowed=f"at most {BLIND_SHARE_MAX:.0%}",
            remedy="light the whole field evenly, and see that the modulator's image covers the sensor",
        )
    return References(on, off, valid, noise)


def _temporal_noise_dn(frames: NDArray[Any]) -> float:
    """Return the noise of one frame in the median pixel; a lamp that flickers does not count as noise."""
    stack = frames.astype(np.float64)
    level = stack.mean(axis=(1, 2), keepdims=True)
    mean_level = float(level.mean())
    even = stack * (mean_level / np.where(level > 0, level, mean_level or 1.0))
    return float(np.sqrt(np.median(even.var(axis=0, ddof=1))))


def _require_switching_light(on: F64, off: F64, error_dn: float, procedure: str) -> None:
    # A field's median is known far better than a pixel, so the smallest signal is set by what a pixel must show.
    least = SIGNAL_SIGMA * max(error_dn, 0.5)
    on_dn, off_dn, swing_dn = (float(np.median(part)) for part in (on, off, on - off))
    if swing_dn < -least:
        raise CalibrationError(
            procedure,
            Reason.WRONG_POLARITY,
            f"the field is brighter with every mirror off ({off_dn:.0f} DN) than with every mirror on ({on_dn:.0f} DN):"
            " the modulator shows patterns inverted",
            remedy="set invert in [modulator] the other way, or look at the mirrors' other side",
        )
    if max(on_dn, off_dn) < least:
        raise CalibrationError(
            procedure,
            Reason.NO_LIGHT,
            f"no light reaches the sensor: {on_dn:.2g} DN above dark with every mirror on",
            allowed=f"at least {least:.2g} DN",
            remedy="take the lens cap off, switch the lamp on, expose longer",
        )
    if swing_dn < least:
        raise CalibrationError(
            procedure,
            Reason.LOW_CONTRAST,
            f"on - off is {swing_dn:.2g} DN: light reaches the sensor, but the mirrors do not change it",
            allowed=f"at least {least:.2g} DN",
            remedy="see that the modulator runs its sequence, is not parked, and lies in the light's path",
        )
    if on_dn < ON_OVER_OFF_MIN * off_dn:
        raise CalibrationError(
            procedure,
            Reason.LOW_CONTRAST,
            f"contrast is only {on_dn / off_dn:.2f}:1 ({on_dn:.0f} DN on, {off_dn:.0f} DN off)",
            allowed=f"{ON_OVER_OFF_MIN}:1 or more",
            remedy="keep stray light out and dump the light of the mirrors that are off",
        )
