"""Masks measured one by one: every pattern on a flat field, with references in between to correct the lamp's drift.

The dark reading is subtracted from each frame, and the result divided by the lamp's level; means over frames give the
images of each mask, of all mirrors on and of all off. The transmission that a solver needs is mask / on, including the
light that closed mirrors leak; (mask - off) / (on - off) = (transmission - leakage) / (1 - leakage) with leakage =
off / on, the contrast map. Here: the order of a pass, the sums, the estimates with their errors. Not here: taking
frames (`taking`), order and polarity (`checks`), masks predicted instead of measured (`predicted`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.errors import InputError
from gs2ci_calibration.masks.lamp import LampRecord, burst_levels
from gs2ci_calibration.masks.noise_model import NoiseModel, fit_noise, own_variance, rounding_variance_dn2
from gs2ci_calibration.masks.references import References

REFERENCE_EVERY: Final = 4
"""A reference of the lamp is taken after this many masks."""
IGNORANT_SE: Final = 1 / np.sqrt(12)
"""Standard error of a transmission that is unknown in [0, 1]."""


class PatternKind(IntEnum):
    """Patterns that are no masks; masks are numbered from 0."""

    ON = -1
    OFF = -2
    HELD_OUT = -3


def pass_order(masks: Sequence[int], *, held_out: bool = False) -> tuple[int, ...]:
    """Return the patterns of one pass: masks in order, all mirrors on before, after and among them, the held-out mask.

    Args:
        masks: Numbers of the masks.
        held_out: Whether to show the held-out mask as well.
    """
    order: list[int] = [PatternKind.ON, PatternKind.OFF]
    for i, mask in enumerate(masks):
        if i % REFERENCE_EVERY == 0 and i:
            order.append(PatternKind.ON)
        order.append(mask)
    return (*order, PatternKind.ON, *((PatternKind.HELD_OUT, PatternKind.ON) if held_out else ()))


class MaskSums:
    """Frames, added up pass by pass.

    Args:
        masks: How many masks there are, N.
        references: The first references of the flat field, which define the lamp's level 1.
        dark: Reading without light, [H, W] or a number, DN.
    """

    def __init__(self, masks: int, references: References, dark: NDArray[np.floating]) -> None:
        self._references = references
        self._dark = np.asarray(dark, dtype=np.float64)
        self._kinds = [*range(masks), *PatternKind]
        shape = (len(self._kinds), *references.on.shape)
        self._sum, self._square = np.zeros(shape), np.zeros(shape)
        self._count = np.zeros(shape[0], dtype=np.int64)
        self._time: list[F64] = []
        self._level: list[F64] = []
        self._burst: list[NDArray[np.int64]] = []

    def add(self, readings: NDArray[Any], time_s: F64, order: Sequence[int]) -> None:
        """Add the frames of some passes.

        Args:
            readings: [P, K, H, W] DN: place p of the order in pass k.
            time_s: When each was exposed, [P, K].
            order: The pattern at each place (`pass_order`), [P]; with at least one `PatternKind.ON`.

        Raises:
            InputError: Shapes disagree, or no frame has all mirrors on.
        """
        if len(readings) != len(order) or time_s.shape != readings.shape[:2] or PatternKind.ON not in order:
            raise InputError(
                f"frames {list(readings.shape)} at times {list(time_s.shape)} for {len(order)} places",
                allowed="[P, K, H, W], [P, K] and P places, with all mirrors on in one of them",
            )
        valid = self._references.valid
        on = [p for p, kind in enumerate(order) if kind == PatternKind.ON]
        swing = self._references.on[valid]
        for k in range(readings.shape[1]):
            seen = np.stack([(readings[p, k].astype(np.float64) - self._dark)[valid] for p in on])
            levels = burst_levels(seen, swing)
            self._time.append(time_s[on, k])
            self._level.append(levels)
            self._burst.append(np.full(len(on), len(self._burst)))
            for p, kind in enumerate(order):
                level = float(np.interp(time_s[p, k], time_s[on, k], levels))
                frame = (readings[p, k] - self._dark) / level
                at = self._kinds.index(kind)
                self._sum[at] += frame
                self._square[at] += np.square(frame)
                self._count[at] += 1

    @property
    def lamp(self) -> LampRecord:
        """Get the lamp's levels so far."""
        return LampRecord(np.concatenate(self._time), np.concatenate(self._level), np.concatenate(self._burst))

    def frames(self, kind: int) -> int:
        """Return how many frames there are of a mask or a `PatternKind`."""
        return int(self._count[self._kinds.index(kind)])

    def mean(self, kind: int) -> F64:
        """Return the mean frame above dark, at the lamp's level 1, [H, W] DN."""
        at = self._kinds.index(kind)
        return self._sum[at] / max(self._count[at], 1)

    def sample_variance(self, kind: int) -> F64:
        """Return the variance between frames, [H, W] DN squared; 0 for a single one."""
        at, count = self._kinds.index(kind), self.frames(kind)
        if count < 2:
            return np.zeros(self._references.on.shape)
        return np.maximum(self._square[at] - np.square(self._sum[at]) / count, 0.0) / (count - 1)

    def noise(self) -> NoiseModel:
        """Return the noise model fitted to all stacks of two frames or more."""
        valid = self._references.valid
        stacks = [kind for kind in self._kinds if self.frames(kind) > 1]
        signal = np.concatenate([self.mean(kind)[valid] for kind in stacks])
        variance = np.concatenate([self.sample_variance(kind)[valid] for kind in stacks])
        return fit_noise(signal, variance, "masks")


@dataclass(frozen=True)
class MeasuredMasks:
    """The measured masks.

    Args:
        masks: Transmissions in the order shown, leakage included, [N, H, W] in [0, 1]; 0 at pixels where unknown.
        standard_error: Standard error of each, [N, H, W].
        held_out: The held-out pattern's transmission, [H, W], not clipped.
        held_out_se: Its standard error, [H, W].
        leakage: Off over on, the contrast map, [H, W].
        leakage_se: Its standard error, [H, W].
        valid: Pixels that see the mirrors switch, [H, W].
        noise: Noise of one frame.
        lamp: The lamp's levels.
    """

    masks: F32
    standard_error: F32
    held_out: F64
    held_out_se: F64
    leakage: F64
    leakage_se: F64
    valid: Bool
    noise: NoiseModel
    lamp: LampRecord

    @property
    def rms_se(self) -> float:
        """Get the standard error, rms over all valid pixels of all masks."""
        return float(np.sqrt(np.mean(np.square(self.standard_error[:, self.valid], dtype=np.float64))))


def estimate_masks(sums: MaskSums, references: References, masks: int, dark_se_dn: float) -> MeasuredMasks:
    """Turn sums into transmissions with standard errors.

    Args:
        sums: The sums of all frames.
        references: The first references of the flat field, for the valid pixels.
        masks: Number of masks, N.
        dark_se_dn: Standard error of the dark reading, DN.

    Raises:
        CalibrationError: Frames do not vary at all.
    """
    noise, lamp = sums.noise(), sums.lamp
    on_mean = sums.mean(PatternKind.ON)
    # The valid pixels were chosen by the first references; a pixel that has died since would cause a division by 0.
    valid = references.valid & (on_mean > 0.5 * references.on)
    on = np.where(valid, on_mean, 1.0)
    on_variance = _variance(sums, PatternKind.ON, noise) / sums.frames(PatternKind.ON)

    def share(kind: int) -> tuple[F64, F64]:
        value = sums.mean(kind) / on
        each = _variance(sums, kind, noise)
        spread = each / sums.frames(kind) + rounding_variance_dn2(each)
        flicker = np.square(lamp.flicker) * (1 / sums.frames(kind) + 1 / sums.frames(PatternKind.ON))
        square = (spread + np.square(value) * on_variance + np.square((1 - value) * dark_se_dn)) / np.square(on)
        error = np.sqrt(square + np.square(value) * flicker)
        return np.where(valid, value, 0.0), np.where(valid, error, IGNORANT_SE)

    shares = [share(i) for i in range(masks)]
    held_out, held_out_se = share(PatternKind.HELD_OUT)
    leakage, leakage_se = share(PatternKind.OFF)
    return MeasuredMasks(
        masks=np.clip([value for value, _ in shares], 0.0, 1.0).astype(np.float32),
        standard_error=np.array([error for _, error in shares], dtype=np.float32),
        held_out=held_out,
        held_out_se=held_out_se,
        leakage=np.clip(leakage, 0.0, 1.0),
        leakage_se=leakage_se,
        valid=valid,
        noise=noise,
        lamp=lamp,
    )


def _variance(sums: MaskSums, kind: int, noise: NoiseModel) -> F64:
    return own_variance(sums.sample_variance(kind), noise.variance(sums.mean(kind)), sums.frames(kind))
