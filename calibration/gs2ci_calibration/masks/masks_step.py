"""The step `masks`: every mask's transmission at every pixel, measured one by one, or predicted from a few frames.

Here: the order of the work in both modes, and the section. Not here: the sums (`measured`), predictions (`predicted`),
recognising masks (`checks`).
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32
from gs2ci_calibration.bench import Bench
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.fitting import codes_sha256, times_of
from gs2ci_calibration.masks.checks import require_held_out, require_order
from gs2ci_calibration.masks.measured import MaskSums, MeasuredMasks, estimate_masks
from gs2ci_calibration.masks.planning import frames_wanted
from gs2ci_calibration.masks.predicted import Relay, model_error, relay_of, transmissions
from gs2ci_calibration.masks.slot_weights import SlotWeights, measure_slots
from gs2ci_calibration.masks.taking import Field, light_up, saturation_of, take
from gs2ci_calibration.refusals import CalibrationError, Reason

Found = tuple[MeasuredMasks, F32, F32, tuple[float, float]]
"""The measurement; the masks and their errors; the predictions' rms error, and the standard error of that."""

STEP: Final = "masks"
PILOT_FRAMES: Final = 2
"""Frames of each mask after which order and polarity are checked and the rest is planned; all of them in fast mode."""
FAST_ACCURACY: Final = 2.0
"""In fast mode masks may have this many times the error required of measured masks."""
HELD_OUT_DENSITY: Final = 0.5


@dataclass(frozen=True)
class Shown:
    """The patterns shown in this step.

    Args:
        patterns: The masks on the modulator's own pixels, [N, Hm, Wm].
        held_out: A pattern that is used only to test the predictions, [Hm, Wm].
        top: Level of a fully open pixel.
    """

    patterns: NDArray[Any]
    held_out: NDArray[Any]
    top: int


def measure_masks(bench: Bench, known: Bundle) -> Section:
    """Measure the masks; with `Options.fast`, predict them.

    Raises:
        CalibrationError: Light, lamp, sensor or modulator are unsuitable; masks are out of order, inverted, rotated or
            shifted since registration; too many frames would be needed; predictions are too inaccurate.
        DriverError: A device failed.
    """
    began_s = bench.devices.clock.now_s()
    relay = relay_of(known.need("registration", STEP), bench.size, STEP)
    field = light_up(bench, known, STEP)
    shown = _shown(bench)
    sums = take(bench, field, shown.patterns, frames=PILOT_FRAMES, step=STEP, held_out=shown.held_out)
    pilot = estimate_masks(sums, field.references, len(shown.patterns), field.dark_se_dn)
    alike = require_order(_between(pilot), relay, shown.patterns, shown.top, pilot.valid, STEP)
    planned = _planned(bench, field, pilot)
    frames, accuracy = (PILOT_FRAMES, FAST_ACCURACY) if bench.fast else (planned, 1.0)
    pilot.lamp.require_steady(frames, accuracy * bench.options.mask_accuracy)
    if bench.fast:
        found, masks, error, off = _foreseen(bench, pilot, relay, shown)
    else:
        take(bench, field, shown.patterns, frames=planned - PILOT_FRAMES, step=STEP, sums=sums, held_out=shown.held_out)
        found, masks, error, off = _measured(sums, field, relay, shown)
        found.lamp.require_steady(frames, accuracy * bench.options.mask_accuracy)
    require_held_out(found.held_out, relay.shares(shown.held_out[None], shown.top)[0], found.valid, STEP)
    slots_s = bench.devices.clock.now_s()
    slots = measure_slots(bench, field, saturation_of(bench, known, field.dark_dn), STEP)
    ended_s = bench.devices.clock.now_s()
    facts = {
        "frames": sums.frames(0),
        "frames_planned": planned,
        "seconds": ended_s - began_s,
        "slot_seconds": ended_s - slots_s,
        "exposure_s": field.exposure_s,
        "rms_standard_error": float(np.sqrt(np.mean(np.square(error[:, found.valid], dtype=np.float64)))),
        "likeness_least": float(alike.min()),
    }
    return _section(bench, found, masks, error, off, slots, facts)


def _shown(bench: Bench) -> Shown:
    top = 2**bench.capture.bit_depth - 1
    is_open = np.random.default_rng(1).random((1, *bench.codes.shape[1:])) < HELD_OUT_DENSITY
    held_out = bench.lay_out(np.where(is_open, top, 0).astype(np.uint16))[0]
    return Shown(np.asarray(bench.capture.masks), held_out, top)


def _between(found: MeasuredMasks) -> F32:
    """Return the measured image of each mask between off (0) and on (1), [N, H, W]."""
    return np.asarray((found.masks - found.leakage) / np.maximum(1 - found.leakage, 1e-3), dtype=np.float32)


def _planned(bench: Bench, field: Field, pilot: MeasuredMasks) -> int:
    """Return how many frames of each mask to take: the rig file's number, or more if the accuracy requires it."""
    options = bench.options
    swing = float(np.median(field.references.on[pilot.valid]))
    wanted = frames_wanted(pilot.rms_se, PILOT_FRAMES, field.dark_se_dn / swing, options.mask_accuracy, STEP)
    return max(wanted, options.mask_frames, PILOT_FRAMES)


def _measured(sums: MaskSums, field: Field, relay: Relay, shown: Shown) -> Found:
    """Estimate all masks, and the error of the held-out mask's prediction."""
    found = estimate_masks(sums, field.references, len(shown.patterns), field.dark_se_dn)
    foreseen = transmissions(relay.shares(shown.held_out[None], shown.top), found.leakage)[0]
    valid = found.valid
    off = model_error(found.held_out[valid], np.square(found.held_out_se)[valid], foreseen[valid])
    return found, found.masks, found.standard_error, off


def _foreseen(bench: Bench, pilot: MeasuredMasks, relay: Relay, shown: Shown) -> Found:
    """Predict all masks, and estimate the predictions' error from the few frames of each.

    Raises:
        CalibrationError: The error is too large.
    """
    between = relay.shares(np.concatenate([shown.patterns, shown.held_out[None]]), shown.top)
    every = np.where(pilot.valid, transmissions(between, pilot.leakage), 0.0).astype(np.float32)
    # The error that the contrast map's noise causes is known for each pixel; the rest is the model's.
    from_contrast = np.square((1 - between) * pilot.leakage_se)
    seen = np.concatenate([pilot.masks, pilot.held_out[None]])[:, pilot.valid]
    variance = np.square(np.concatenate([pilot.standard_error, pilot.held_out_se[None]])) + from_contrast
    off = model_error(seen, variance[:, pilot.valid], every[:, pilot.valid])
    allowed = FAST_ACCURACY * bench.options.mask_accuracy
    if off[0] - 2 * off[1] > allowed:
        raise CalibrationError(
            STEP,
            Reason.MISPREDICTED,
            f"predicted masks are off by {off[0]:.2%} rms",
            allowed=f"{allowed:.2%}",
            remedy="measure them one by one (without --fast), or register again with more frames",
        )
    error = np.where(pilot.valid, np.sqrt(off[0] ** 2 + from_contrast[:-1]), pilot.standard_error).astype(np.float32)
    return pilot, every[:-1], error, off


def _section(
    bench: Bench,
    found: MeasuredMasks,
    masks: F32,
    error: F32,
    off: tuple[float, float],
    slots: SlotWeights,
    facts: dict[str, Any],
) -> Section:
    fast = bench.fast
    contrast = 1 / max(float(np.median(found.leakage[found.valid])), 1e-6)
    how = "predicted from map, blur and contrast" if fast else f"measured one by one, {facts['frames']} frames each"
    blind = int((~found.valid).sum())
    notes = [
        f"{len(masks)} masks {how}: standard error {facts['rms_standard_error']:.2%} rms; a held-out pattern is "
        f"predicted to {off[0]:.2%} rms.",
        f"Order and polarity are those that were sent, by image; contrast {contrast:.0f}:1 in the median pixel.",
        f"The lamp drifted by {found.lamp.drift:.2%} and flickered by {found.lamp.flicker:.3%} rms.",
        slots.note,
        *([f"{blind} pixels do not see the mirrors switch: their masks are 0."] if blind else []),
    ]
    return Section(
        name=STEP,
        estimates={
            "masks": Estimate(masks, error, "1"),
            "contrast": Estimate(found.leakage.astype(np.float32), found.leakage_se.astype(np.float32), "1"),
            "weights": slots.weights,
            "prediction_error_rms": Estimate(off[0], off[1], "1"),
        },
        arrays={"patterns_sha256": codes_sha256(bench.codes), "valid": found.valid.astype(np.uint8)},
        facts={
            "mode": "predicted" if fast else "measured",
            "order": "as sent, checked by image",
            "polarity": "as sent, checked by image",
            **times_of(bench.capture),
            "region": bench.region,
            "weights": "measured" if slots.measured else "planned",
            "lamp_drift": found.lamp.drift,
            "lamp_flicker": found.lamp.flicker,
            **facts,
        },
        notes=tuple(notes),
    )
