"""The flat field with every mirror on and with every mirror off: the references of all transmissions.

Here: the two references, the pixels that can be trusted, and the refusal of unsuitable fields. Not here: the lamp's
drift between frames (`lamp`), masks (`masks`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64, Bool
from gs2ci_calibration.refusals import CalibrationError, Reason

# Fewest frames of each reference: noise cannot be estimated from one.
FRAMES_MIN: Final = 2
# Share of saturated pixels from which on the whole field is refused, not only these pixels.
SATURATED_SHARE_MAX: Final = 0.01
# A pixel is blind if the mirrors change its reading by less than this share of the median pixel's change.
BLIND_BELOW: Final = 0.05
BLIND_SHARE_MAX: Final = 0.25
# Standard deviations by which light must rise above darkness, and on above off, in the median pixel.
SIGNAL_SIGMA: Final = 5.0
# Contrast below which masks cannot be separated from leakage.
ON_OVER_OFF_MIN: Final = 1.5
# If a frame with every mirror off exceeds this level, as a share of on minus off, it shows another pattern.
OFF_LEVEL_MAX: Final = 0.15
# If a frame with every mirror on is below this share of the brightest frame of its pass, it shows another pattern,
# provided that a frame elsewhere in the pass reaches the second share.
ON_LEVEL_MIN: Final = 0.8
ALSO_ON_LEVEL: Final = 0.95


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
    valid: Bool
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


def average_references(
    on_frames: NDArray[Any], off_frames: NDArray[Any], dark: NDArray[np.floating], *, saturation_dn: float, step: str
) -> References:
    """Average the references; refuse a field on which masks cannot be measured.

    Args:
        on_frames: Raw frames with every mirror on, [F, H, W] DN, F at least 2.
        off_frames: With every mirror off, [F, H, W], F at least 2.
        dark: Reading without light at this exposure, [H, W] or a number, DN.
        saturation_dn: Reading from which on a pixel may be clipped.
        step: For messages.

    Raises:
        CalibrationError: A single frame; saturated; no light (lens cap, lamp); the mirrors change nothing; on is
            darker than off (polarity); contrast too low; dead rows or columns, or too many blind pixels.
    """
    clipped = _require_sound(on_frames, off_frames, saturation_dn, step)
    on = on_frames.mean(axis=0, dtype=np.float64) - dark
    off = off_frames.mean(axis=0, dtype=np.float64) - dark
    noise = _temporal_noise_dn(on_frames)
    _require_switching_light(on, off, noise / np.sqrt(min(len(on_frames), len(off_frames))), step)
    swing = on - off
    valid = (swing > BLIND_BELOW * float(np.median(swing[swing > 0]))) & ~clipped & (on > 0)
    if (~valid).mean() > BLIND_SHARE_MAX:
        raise CalibrationError(
            step,
            Reason.DEAD_PIXELS,
            f"{(~valid).mean():.1%} of the pixels do not see the mirrors switch",
            allowed=f"at most {BLIND_SHARE_MAX:.0%}",
            remedy="light the whole field evenly, and check that the modulator's image covers the sensor",
        )
    references = References(on, off, valid, noise)
    _require_lines(references, step)
    return references


def _require_sound(on_frames: NDArray[Any], off_frames: NDArray[Any], saturation_dn: float, step: str) -> Bool:
    """Refuse too few frames and a saturated field; return the pixels that are clipped, [H, W]."""
    for what, frames in (("on", on_frames), ("off", off_frames)):
        if frames.ndim != 3 or len(frames) < FRAMES_MIN:
            count = len(frames) if frames.ndim == 3 else 0
            raise CalibrationError(
                step,
                Reason.TOO_FEW_FRAMES,
                f"{count} frames with every mirror {what}",
                allowed=f"at least {FRAMES_MIN}: noise cannot be estimated from one",
            )
    clipped = np.mean(on_frames >= saturation_dn, axis=0) > 0
    if clipped.mean() > SATURATED_SHARE_MAX:
        raise CalibrationError(
            step,
            Reason.SATURATED,
            f"{clipped.mean():.1%} of the pixels saturate with every mirror on",
            allowed=f"at most {SATURATED_SHARE_MAX:.0%}",
            remedy="shorten mask_s, dim the lamp or close the aperture until the flat field reads 50 to 80 % of full",
        )
    return np.asarray(clipped)


def require_in_place(
    references: References, readings: NDArray[Any], dark: NDArray[np.floating], order: Sequence[int], step: str
) -> None:
    """Check by brightness that the references of each pass are at their places among the patterns.

    Args:
        references: From `average_references`.
        readings: [P, K, H, W] DN: place p of the order in pass k.
        dark: Reading without light, [H, W].
        order: The pattern at each place, [P]; all mirrors on is -1, all off is -2 (`measured.PatternKind`).
        step: For messages.

    Raises:
        CalibrationError: They are not: patterns are shown in another order than sent.
    """
    kinds = np.array(order)
    is_on, is_off = kinds == -1, kinds == -2
    whole = float(references.on[references.valid].mean())
    off = float(references.off[references.valid].mean()) / whole
    level = np.stack([(frame - dark)[..., references.valid].mean(axis=-1) for frame in readings]) / whole
    brightest = level.max(axis=0)
    lit_off = level[is_off] > (off + OFF_LEVEL_MAX * (1 - off)) * brightest
    dim_on = (level[is_on] < ON_LEVEL_MIN * brightest) & (
        level[~is_on].max(axis=0, initial=0) > ALSO_ON_LEVEL * brightest
    )
    for wrong, places in ((lit_off, np.flatnonzero(is_off)), (dim_on, np.flatnonzero(is_on))):
        if wrong.any():
            place, k = (int(i) for i in np.argwhere(wrong)[0])
            shown = int(places[place])
            raise CalibrationError(
                step,
                Reason.WRONG_ORDER,
                f"pattern {shown} of pass {k}, every mirror {'on' if is_on[shown] else 'off'}, reads "
                f"{level[shown, k]:.0%} of the open field: another pattern is shown instead",
                remedy="check how patterns are packed into the modulator's images, and that the first trigger comes "
                "with the first pattern",
            )


def _require_lines(references: References, step: str) -> None:
    rows, columns = references.blind_rows(), references.blind_columns()
    if rows or columns:
        lines = [
            f"{name} {', '.join(map(str, which[:3]))}{' ...' if len(which) > 3 else ''}"
            for name, which in (("rows", rows), ("columns", columns))
            if which
        ]
        raise CalibrationError(
            step,
            Reason.DEAD_PIXELS,
            f"all of {' and '.join(lines)} do not see the mirrors switch",
            allowed="no whole row or column",
            remedy="crop the sensor in [sensor], or check that the modulator's image covers it",
        )


def _temporal_noise_dn(frames: NDArray[Any]) -> float:
    """Return the noise of one frame in the median pixel, without the lamp's flicker."""
    stack = frames.astype(np.float64)
    level = stack.mean(axis=(1, 2), keepdims=True)
    mean_level = float(level.mean())
    even = stack * (mean_level / np.where(level > 0, level, mean_level or 1.0))
    return float(np.sqrt(np.median(even.var(axis=0, ddof=1))))


def _require_switching_light(on: F64, off: F64, error_dn: float, step: str) -> None:
    # The median of a field is known far better than a pixel, so the smallest signal follows from a pixel's noise.
    least = SIGNAL_SIGMA * max(error_dn, 0.5)
    on_dn, off_dn, swing_dn = (float(np.median(part)) for part in (on, off, on - off))
    if swing_dn < -least:
        raise CalibrationError(
            step,
            Reason.WRONG_POLARITY,
            f"the field is brighter with every mirror off ({off_dn:.0f} DN) than with every mirror on ({on_dn:.0f} DN):"
            " the modulator shows patterns inverted",
            remedy="change `invert` in [modulator], or look at the mirrors' other side",
        )
    if max(on_dn, off_dn) < least:
        raise CalibrationError(
            step,
            Reason.NO_LIGHT,
            f"no light reaches the sensor: {on_dn:.2g} DN above dark with every mirror on",
            allowed=f"at least {least:.2g} DN",
            remedy="take the lens cap off, switch the lamp on, expose longer",
        )
    if swing_dn < least:
        raise CalibrationError(
            step,
            Reason.LOW_CONTRAST,
            f"on - off is {swing_dn:.2g} DN: light reaches the sensor, but the mirrors do not change it",
            allowed=f"at least {least:.2g} DN",
            remedy="check that the modulator runs its sequence, is not parked, and lies in the light's path",
        )
    if on_dn < ON_OVER_OFF_MIN * off_dn:
        raise CalibrationError(
            step,
            Reason.LOW_CONTRAST,
            f"contrast is only {on_dn / off_dn:.2f}:1 ({on_dn:.0f} DN on, {off_dn:.0f} DN off)",
            allowed=f"{ON_OVER_OFF_MIN}:1 or more",
            remedy="keep stray light out and dump the light of the mirrors that are off",
        )
