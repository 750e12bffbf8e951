"""The requested pattern sequence, the limits of a modulator, and the check of the sequence against the limits.

Here: the records `PatternSequence`, `TriggerOut` and `ModulatorInfo`, and the check. Not here: the device that shows
them (`gs2ci_drivers.modulator`), masks from files or from draws (`gs2ci.rig.patterns`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from math import ceil

import numpy as np

from gs2ci.core.arrays import F64, U8, U16
from gs2ci_drivers.failures import OutOfRangeError, UnsupportedError


class TriggerOut(Enum):
    """What the modulator's trigger output does while a sequence runs."""

    NONE = "none"
    """Nothing: the sensor runs freely."""
    PER_EXPOSURE = "per-exposure"
    """One pulse when the first mask of each pass appears: one sensor frame integrates all masks (mode A)."""
    GATE = "gate"
    """A level held from the first mask's appearance to the last one's end, for a level-gated sensor (mode B)."""
    PER_MASK = "per-mask"
    """One pulse when each mask appears: one sensor frame per mask, for calibration (mode C)."""
    GATE_PER_MASK = "gate-per-mask"
    """A level held while each mask is on show: mode C for a level-gated sensor; masks have dark time between them."""


@dataclass(frozen=True)
class ModulatorInfo:
    """What a modulator is and can do, as read from the device or fixed by its model.

    Args:
        model: Maker and model.
        serial: Serial number, or "" if the device does not report one.
        firmware: Version text.
        height: Rows of mirrors or pixels.
        width: Columns.
        pitch_m: Distance of neighbouring pixels.
        min_exposure_s: Shortest exposure of one mask by bit depth; its keys are the supported depths.
        max_exposure_s: Longest exposure of one mask.
        exposure_step_s: Exposures and dark times are multiples of this.
        min_dark_s: Shortest dark time greater than zero.
        capacity: Largest number of masks in one sequence, by bit depth.
        trigger_outs: The supported modes of the trigger output.
        trigger_delay_s: From a mask's appearance to the edge of a pulse (negative: the edge comes first).
        gate_delay_s: From a mask's appearance to the edge that begins a gate; None is `trigger_delay_s`.
        gate_longer_s: By how much a gate is held longer than its masks are shown.
        start_latency_s: Longest time from `start` to the first mask; None if the host times each mask.
        typical_start_s: Usual time from `start` to the first mask; None takes half of the longest.
        hardware_timed: Whether the device's own clock steps the masks. If false, the host steps them, and only
            `TriggerOut.NONE` and `PER_MASK` are possible.
        experimental: Whether the protocol is unconfirmed on real hardware.
        pulses_unsettled: What is still unknown about the trigger pulses, so that no capture may rely on them; "" if
            nothing is.
        whole_pauses: Whether the pause after a pass is made of dark masks: a mask's dark time and whole periods.
        grey_unsettled: Why the light of a grey level may not be in proportion to it, so that only measured grey masks
            may be used; "" if it is.
    """

    model: str
    serial: str
    firmware: str
    height: int
    width: int
    pitch_m: float
    min_exposure_s: Mapping[int, float]
    max_exposure_s: float
    exposure_step_s: float
    min_dark_s: float
    capacity: Mapping[int, int]
    trigger_outs: frozenset[TriggerOut]
    trigger_delay_s: float = 0.0
    gate_delay_s: float | None = None
    gate_longer_s: float = 0.0
    start_latency_s: float | None = 0.05
    typical_start_s: float | None = None
    hardware_timed: bool = True
    experimental: bool = False
    pulses_unsettled: str = ""
    whole_pauses: bool = False
    grey_unsettled: str = ""

    @property
    def expected_start_s(self) -> float:
        """Get the expected time from `start` to the first mask."""
        if self.typical_start_s is not None:
            return self.typical_start_s
        return (self.start_latency_s or 0.0) / 2

    def delay_s(self, out: TriggerOut) -> float:
        """Return the time from a mask's appearance to the edge that begins an exposure."""
        gated = out in (TriggerOut.GATE, TriggerOut.GATE_PER_MASK)
        return self.trigger_delay_s if self.gate_delay_s is None or not gated else self.gate_delay_s

    def quantise_s(self, time_s: float) -> float:
        """Return a time as an upload keeps it: the nearest multiple of the step, but never 0 for a time above 0."""
        return max(round(time_s / self.exposure_step_s), 1 if time_s > 0 else 0) * self.exposure_step_s

    def at_least_s(self, time_s: float) -> float:
        """Return the shortest multiple of the step that is not shorter than a time."""
        step = self.exposure_step_s
        return ceil(time_s / step - 1e-6) * step  # 1e-6 steps: rounding error of the division

    def pause_at_least_s(self, pause_s: float, exposure_s: float, dark_s: float) -> float:
        """Return the shortest pause after a pass that the device can keep and that lasts a time above 0."""
        if not self.whole_pauses:
            return self.at_least_s(max(pause_s, self.min_dark_s))
        period_s = self.quantise_s(exposure_s) + self.quantise_s(dark_s)
        return dark_s + max(ceil((pause_s - dark_s) / period_s - 1e-6), 0 if dark_s else 1) * period_s


@dataclass(frozen=True)
class PatternSequence:
    """Masks and their timing: one pass shows every mask once and is one coded exposure.

    Args:
        masks: [N, H, W] uint8 (depth ≤ 8) or uint16, levels 0 to 2**bit_depth − 1; a binary mask is 0 and 1.
            H, W are the modulator's own.
        bit_depth: Bits of each mask.
        exposure_s: How long each mask is shown.
        dark_s: Dark time after each mask but the last.
        pause_s: Dark time after the last mask of a pass, in which the sensor may read out.
        repeats: How many passes one `start` shows; 0 runs until `disarm`.
        trigger: What the trigger output does.
        first: The mask with which a pass begins; those before it are shown after the last one.
    """

    masks: U8 | U16
    bit_depth: int
    exposure_s: float
    dark_s: float = 0.0
    pause_s: float = 0.0
    repeats: int = 1
    trigger: TriggerOut = TriggerOut.PER_EXPOSURE
    first: int = 0

    @property
    def order(self) -> list[int]:
        """Get the masks' indices in the order in which a pass shows them."""
        return [(self.first + i) % self.count for i in range(self.count)]

    def in_order(self) -> "PatternSequence":
        """Return the same passes with the masks in the order in which they are shown."""
        return self if self.first == 0 else replace(self, masks=self.masks[self.order], first=0)

    @property
    def count(self) -> int:
        """Get the number of masks, N."""
        return int(self.masks.shape[0])

    @property
    def period_s(self) -> float:
        """Get the time from one pass's first mask to the next pass's first mask."""
        return self.count * self.exposure_s + (self.count - 1) * self.dark_s + self.pause_s

    @property
    def pulses(self) -> int:
        """Get how often the trigger output becomes active in all passes."""
        per_pass = {TriggerOut.NONE: 0, TriggerOut.PER_MASK: self.count, TriggerOut.GATE_PER_MASK: self.count}
        return self.repeats * per_pass.get(self.trigger, 1)

    @property
    def duration_s(self) -> float:
        """Get the time that all passes take (infinite when `repeats` is 0)."""
        return self.repeats * self.period_s if self.repeats else float("inf")

    def windows_s(self) -> F64:
        """Return when each mask of a pass is on show, [N, 2] start and end, from the first mask's appearance."""
        starts = np.arange(self.count) * (self.exposure_s + self.dark_s)
        return np.stack([starts, starts + self.exposure_s], axis=1)


def check_sequence(device: str, info: ModulatorInfo, sequence: PatternSequence) -> None:
    """Accept a sequence that a modulator with these limits can show.

    Raises:
        OutOfRangeError: Shape, depth, levels, a time or the number of masks is beyond the device.
        UnsupportedError: The trigger output cannot do what the sequence needs.
    """
    _check_masks(device, info, sequence)
    _check_times(device, info, sequence)
    if sequence.trigger not in info.trigger_outs:
        raise UnsupportedError(
            device,
            f"trigger output {sequence.trigger.value!r} is not available",
            asked="upload",
            allowed=", ".join(sorted(out.value for out in info.trigger_outs)),
            remedy="choose another `mode` in [capture]",
        )
    if sequence.repeats < 0:
        raise OutOfRangeError(device, f"repeats = {sequence.repeats}", asked="upload", allowed="0 or more")
    if not 0 <= sequence.first < sequence.count:
        allowed = f"0 to {sequence.count - 1}"
        raise OutOfRangeError(device, f"first = {sequence.first}", asked="upload", allowed=allowed)


def _check_masks(device: str, info: ModulatorInfo, sequence: PatternSequence) -> None:
    masks, depth = sequence.masks, sequence.bit_depth
    if depth not in info.min_exposure_s:
        raise OutOfRangeError(
            device,
            f"masks of {depth} bits",
            asked="upload",
            allowed=", ".join(str(bits) for bits in sorted(info.min_exposure_s)),
        )
    if masks.ndim != 3 or masks.shape[0] < 1 or masks.shape[1:] != (info.height, info.width):
        raise OutOfRangeError(
            device,
            f"masks of shape {list(masks.shape)}",
            asked="upload",
            allowed=f"[N, {info.height}, {info.width}] with N >= 1",
            remedy="lay the masks out on the modulator's own pixels first",
        )
    top = 2**depth - 1
    if masks.dtype not in (np.uint8, np.uint16) or int(masks.max()) > top:
        raise OutOfRangeError(
            device,
            f"mask levels up to {masks.max()} as {masks.dtype}",
            asked="upload",
            allowed=f"uint8 or uint16 from 0 to {top} for {depth} bits",
        )
    if masks.shape[0] > info.capacity[depth]:
        raise OutOfRangeError(
            device,
            f"{masks.shape[0]} masks of {depth} bits",
            asked="upload",
            allowed=f"at most {info.capacity[depth]}",
            remedy="use fewer masks or fewer bits",
        )


def _check_times(device: str, info: ModulatorInfo, sequence: PatternSequence) -> None:
    shortest = info.min_exposure_s[sequence.bit_depth]
    slack_s = info.exposure_step_s / 2  # the largest rounding error to the device's step
    if not shortest - slack_s <= sequence.exposure_s <= info.max_exposure_s + slack_s:
        raise OutOfRangeError(
            device,
            f"mask exposure {sequence.exposure_s * 1e6:.1f} us at {sequence.bit_depth} bits",
            asked="upload",
            allowed=f"{shortest * 1e6:.1f} to {info.max_exposure_s * 1e6:.0f} us",
        )
    for what, dark_s in (("dark time", sequence.dark_s), ("pause", sequence.pause_s)):
        if dark_s != 0 and not info.min_dark_s - slack_s <= dark_s <= info.max_exposure_s + slack_s:
            raise OutOfRangeError(
                device,
                f"{what} {dark_s * 1e6:.1f} us",
                asked="upload",
                allowed=f"0, or {info.min_dark_s * 1e6:.1f} to {info.max_exposure_s * 1e6:.0f} us",
            )
