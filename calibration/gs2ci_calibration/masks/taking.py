"""Taking frames of patterns on the flat field: exposure, references, and passes with references among them.

Here: the parts that the steps `registration` and `masks` share. Not here: the evaluation (`measured`, `registration`),
the search for an exposure (`exposing`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F64
from gs2ci_calibration.bench import Arrangement, Bench, Stack
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.exposing import find_exposure
from gs2ci_calibration.fitting import needed
from gs2ci_calibration.frames import Dark
from gs2ci_calibration.masks.measured import MaskSums, PatternKind, pass_order
from gs2ci_calibration.masks.references import References, average_references, require_in_place

FILL: Final = 0.6
"""Share of the sensor's range to which the open field is exposed: far from clipping, with nearly the best precision."""
REFERENCE_FRAMES: Final = 8
CLIPPED_SHARE: Final = 0.98
"""Share of the range above black from which on a reading counts as clipped, if no measured value is known."""
BYTES_AT_ONCE: Final = 512 * 2**20
"""Largest memory for the frames of one run of the modulator."""


@dataclass(frozen=True)
class Field:
    """The flat field, exposed so that masks can be measured on it.

    Args:
        exposure_s: Exposure of each frame.
        dark_dn: Reading without light at this exposure, [H, W].
        dark_se_dn: Its standard error, rms over the pixels.
        references: All mirrors on, all off.
        first: The frames of these references, on before off.
    """

    exposure_s: float
    dark_dn: F64
    dark_se_dn: float
    references: References
    first: Stack


def light_up(bench: Bench, known: Bundle, step: str) -> Field:
    """Request the flat field, find an exposure and check the references.

    Raises:
        CalibrationError: No dark frames are known; the light, the sensor or the modulator is unsuitable
            (`average_references`).
        DriverError: A device failed.
    """
    section = needed(known, "dark-flat", bench, step)
    dark = Dark.of(section)
    bench.please(Arrangement.FLAT)
    exposure_s = find_exposure(bench, step, dark, FILL).exposure_s
    dark_dn = dark.at(exposure_s)
    errors = [section.estimates[key].error for key in ("offset_dn", "dark_current_dn_per_s")]
    dark_se_dn = float(np.hypot(errors[0], exposure_s * errors[1]))
    both = bench.deep(np.stack([bench.flat_pattern(is_open=is_open) for is_open in (True, False)]))
    frames = max(REFERENCE_FRAMES, bench.options.mask_frames)
    stack = bench.grab(both, frames=frames, exposure_s=exposure_s, bit_depth=bench.capture.bit_depth)
    references = average_references(
        stack.readings[0], stack.readings[1], dark_dn, saturation_dn=saturation_of(bench, known, dark_dn), step=step
    )
    return Field(exposure_s, dark_dn, dark_se_dn, references, stack)


def take(
    bench: Bench,
    field: Field,
    masks: NDArray[Any],
    *,
    frames: int,
    step: str,
    sums: MaskSums | None = None,
    held_out: NDArray[Any] | None = None,
) -> MaskSums:
    """Take frames of each mask, with references among them, in as few runs of the modulator as it can hold.

    Args:
        bench: The bench; the flat field is set up.
        field: From `light_up`.
        masks: Levels on the modulator's own pixels, [N, Hm, Wm].
        frames: Number of frames of each mask.
        step: For messages.
        sums: Sums of frames taken before, to which these are added; None begins new ones.
        held_out: A further pattern to be shown, [Hm, Wm].

    Raises:
        CalibrationError: References are not at their places among the patterns (`require_in_place`).
        DriverError: A device failed.
    """
    if sums is None:
        sums = MaskSums(len(masks), field.references, field.dark_dn)
        sums.add(field.first.readings, field.first.time_s, (PatternKind.ON, PatternKind.OFF))
    if frames <= 0:
        return sums
    bench.progress.stage(f"{step}: frames of each pattern", frames)
    for order in _runs(len(masks), held_out is not None, bench.capacity):
        shown = _shown(bench, order, masks, held_out)
        at_once = max(BYTES_AT_ONCE // (4 * len(order) * int(np.prod(bench.size))), 1)
        done = 0
        while done < frames:
            count = min(at_once, frames - done)
            stack = bench.grab(shown, frames=count, exposure_s=field.exposure_s, bit_depth=bench.capture.bit_depth)
            require_in_place(field.references, stack.readings, field.dark_dn, order, step)
            sums.add(stack.readings, stack.time_s, order)
            done += count
            bench.progress.step(done)
    return sums


def refined(field: Field, sums: MaskSums) -> Field:
    """Return the field with the references taken among the patterns instead of the first ones."""
    first = field.references
    on, off = sums.mean(PatternKind.ON), sums.mean(PatternKind.OFF)
    # A pixel that has died since would cause a division by 0.
    valid = first.valid & (on - off > 0.5 * (first.on - first.off))
    return replace(field, references=replace(first, on=on, off=off, valid=valid))


def _runs(masks: int, held_out: bool, capacity: int) -> list[tuple[int, ...]]:
    """Split the masks into as many runs as the modulator's memory requires; return the patterns of each run."""
    runs = 1
    while True:
        parts = np.array_split(np.arange(masks), runs)
        orders = [pass_order([int(i) for i in part], held_out=held_out) for part in parts]
        if max(len(order) for order in orders) <= capacity or runs >= masks:
            return orders
        runs += 1


def _shown(bench: Bench, order: Sequence[int], masks: NDArray[Any], held_out: NDArray[Any] | None) -> NDArray[Any]:
    shut, unshut = (bench.deep(bench.flat_pattern(is_open=is_open)) for is_open in (False, True))
    shown = np.empty((len(order), *bench.modulator_size), np.result_type(masks, unshut))
    for place, kind in enumerate(order):
        match kind:
            case PatternKind.ON:
                shown[place] = unshut
            case PatternKind.OFF:
                shown[place] = shut
            case PatternKind.HELD_OUT:
                shown[place] = held_out
            case _:
                shown[place] = masks[kind]
    return shown


def saturation_of(bench: Bench, known: Bundle, dark_dn: F64) -> float:
    """Return the reading from which on a pixel counts as clipped: as measured, or near the end of the format."""
    if "sensor" in known and "saturation_dn" in known.sections["sensor"].estimates:
        return known.sections["sensor"].number("saturation_dn")
    black = float(np.median(dark_dn))
    return black + CLIPPED_SHARE * (bench.top_dn - black)
