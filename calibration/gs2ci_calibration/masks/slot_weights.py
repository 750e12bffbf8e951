"""Slot weights: the share of each mask's time that an exposure of `gs2ci capture` really spans, measured by light.

One mask is replaced by all mirrors on, the others by all off: such a coded exposure has the light of that slot only.
The first and the last slot are measured like this and compared with one in the middle. All slots between the ends are
spanned completely by definition. The middle slot is exposed before, between and after the two, and its light, which is
the lamp's, is interpolated to their times. Here: that measurement. Not here: trigger latency and jitter (step
`timing`).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from gs2ci.core.arrays import F64, Bool
from gs2ci_calibration.bench import Bench
from gs2ci_calibration.estimates import Estimate
from gs2ci_calibration.masks.taking import Field
from gs2ci_calibration.refusals import CalibrationError, Reason
from gs2ci_drivers.plan import Mode

FRAMES: Final = 8
WHOLE: Final = 1 - 1e-9
"""Planned weight from which on a slot counts as spanned completely."""
PLANNED_SE: Final = 1e-3
"""Standard error of weights that are planned and not measured: jitter of 10 us in 10 ms."""
LEVELS: Final = (0.02, 0.8)
"""Share of the sensor's range that one slot must fill in the median pixel to be measured; brighter pixels have room."""
LEFT_OVER: Final = 0.5
"""Share of the middle slot's own difference from its interpolated light that counts as the ends' error by the lamp.

Interpolation over half the time leaves a quarter of it if the lamp's change is smooth, 0.7 of it if the lamp wanders.
"""
OFF_PLAN: Final = 0.05
"""A weight that differs from the plan by more than this is refused: the sensor does not expose at the right time."""


@dataclass(frozen=True)
class SlotWeights:
    """Weights of the masks in one exposure.

    Args:
        weights: [N], 1 for a mask that is exposed during its whole time.
        measured: Whether they are measured by light; otherwise they are as planned, for the reason in `note`.
        note: A sentence about them.
    """

    weights: Estimate
    measured: bool
    note: str


def measure_slots(bench: Bench, field: Field, saturation_dn: float, step: str) -> SlotWeights:
    """Measure the weights of the capture's slots on the flat field, or state why they are taken as planned.

    Raises:
        CalibrationError: A slot's light contradicts the plan (`Reason.BAD_FIT`).
        DriverError: A device failed.
    """
    plan = bench.planned()
    planned = np.asarray(plan.weights, dtype=np.float64)
    whole = planned >= WHOLE
    capture = bench.capture
    reason = _why_not_measured(bench, whole)
    slot_dn = float(np.median((field.references.on - field.references.off)[field.references.valid]))
    slot_dn *= capture.mask_s / field.exposure_s
    off_dn = float(np.median(field.references.off[field.references.valid])) * capture.mask_s / field.exposure_s
    black = float(np.median(field.dark_dn))
    range_dn = saturation_dn - black
    if not reason and not LEVELS[0] * range_dn < slot_dn + len(planned) * off_dn < LEVELS[1] * range_dn:
        reason = "the light of one slot does not suit the sensor's range"
    if reason:
        return SlotWeights(Estimate(planned, PLANNED_SE, "1"), False, f"Slot weights are as planned: {reason}.")
    ends = [0, len(planned) - 1]
    mean = planned.copy()
    mean[ends], error = _shares_of_ends(bench, field, plan.exposure_s, ends, len(planned) // 2)
    worst = int(np.argmax(np.abs(mean - planned)))
    if abs(mean[worst] - planned[worst]) > OFF_PLAN:
        raise CalibrationError(
            step,
            Reason.BAD_FIT,
            f"an exposure covers {mean[worst]:.1%} of the time of mask {worst}; by the plan {planned[worst]:.1%}",
            allowed=f"within {OFF_PLAN:.0%}",
            remedy="check the trigger's latency (`gs2ci calibrate timing`) and the sensor's true exposure",
        )
    return SlotWeights(
        Estimate(mean, error, "1"),
        True,
        f"By light, an exposure covers {mean[0]:.2%} and {mean[-1]:.2%} of the first and the last mask's time.",
    )


def _why_not_measured(bench: Bench, whole: Bool) -> str:
    if bench.capture.mode is Mode.PER_MASK:
        return f"in the mode {bench.capture.mode.value} no exposure spans several masks by the sensor's own clock"
    if bench.capture.dark_s > 0:
        return "dark time between the masks hides their edges"
    if len(whole) < 3 or not whole[1:-1].all():
        return "no mask between the first and the last is exposed for its whole time, as a comparison needs"
    return ""


def _shares_of_ends(bench: Bench, field: Field, exposure_s: float, ends: list[int], middle: int) -> tuple[F64, float]:
    """Return the light of the first and the last slot over that of the middle one, [2], and its standard error."""
    capture, valid = bench.capture, field.references.valid
    unshut = bench.deep(bench.flat_pattern(is_open=True))

    def light_of(slot: int | None) -> tuple[float, F64]:
        """Return the mean time of `FRAMES` exposures with one slot open, or none, and the light of each, DN."""
        patterns = np.zeros(capture.masks.shape, unshut.dtype)
        if slot is not None:
            patterns[slot] = unshut
        stack = bench.expose(
            patterns, mask_s=capture.mask_s, exposure_s=exposure_s, frames=FRAMES, bit_depth=capture.bit_depth
        )
        return float(stack.time_s.mean()), stack.readings[0][:, valid].mean(axis=1, dtype=np.float64)

    shown = (middle, ends[0], middle, None, ends[1], middle)
    taken = [light_of(slot) for slot in shown]
    time_s = np.array([time for time, _ in taken])
    light = np.array([frames.mean() for _, frames in taken]) - taken[shown.index(None)][1].mean()
    at_middle, at_ends = ([place for place, slot in enumerate(shown) if slot in slots] for slots in ([middle], ends))
    lamp = np.interp(time_s[at_ends], time_s[at_middle], light[at_middle])
    left_over = light[at_middle[1]] / np.interp(time_s[at_middle[1]], time_s[at_middle[::2]], light[at_middle[::2]]) - 1
    # The frames' errors are the same in all slots: pooled, they are estimated better than from each slot's few frames.
    # Second differences, of six times the variance of one frame, are free of a steady drift.
    noise = np.mean([np.square(np.diff(taken[place][1], n=2)) for place in (*at_middle, *at_ends)]) / 6
    noise /= np.square(lamp.mean())
    # Of two of the middle slot's stacks, the interpolation takes half each.
    return light[at_ends] / lamp, float(np.sqrt(1.5 * noise / FRAMES + np.square(LEFT_OVER * left_over)))
