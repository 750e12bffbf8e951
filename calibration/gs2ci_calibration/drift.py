"""How far a bench has drifted since it was calibrated: a few frames compared with the bundle.

Here: `changes_since`, behind `gs2ci calibrate check`. Not here: checks that need no frame (`fitting`), the check of one
mask (`probe`, which is used).
"""

from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from gs2ci_calibration.bench import Arrangement, Bench, Stack
from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.estimates import Section
from gs2ci_calibration.exposing import NO_LIGHT_DN
from gs2ci_calibration.frames import Dark, check_stack, noise_variance, refuse_dark
from gs2ci_calibration.probe import DIFFERENCE_LIMIT, SHIFT_LIMIT_PX, probe_mask

STEP: Final = "check"
FRAMES: Final = 8
OFFSET_LIMIT: Final = 0.25
"""Allowed change of the black level, in standard deviations of a pixel's dark noise."""
NOISE_LIMIT: Final = 0.1
RESPONSE_LIMIT: Final = 0.01
GAIN_LIMIT: Final = 0.05


@dataclass(frozen=True)
class Change:
    """A property that may have changed.

    Args:
        what: The property.
        value: Its change.
        error: Standard error of the change.
        limit: Largest allowed change; None if any change is harmless.
        unit: Unit of all three.
        step: The step of `gs2ci calibrate` that measures it again.
    """

    what: str
    value: float
    error: float
    limit: float | None
    unit: str
    step: str

    @property
    def too_far(self) -> bool:
        """Get whether it has changed significantly by more than the limit."""
        return self.limit is not None and abs(self.value) - 2 * self.error > self.limit

    def record(self) -> dict[str, Any]:
        """Return plain values."""
        return {**asdict(self), "too_far": self.too_far}


def changes_since(bench: Bench, bundle: Bundle) -> list[Change]:
    """Take a few dark and flat frames and one mask, and compare them with a bundle.

    Args:
        bench: The bench; its operator sets up dark and even light.
        bundle: A bundle with any of the sections dark-flat, sensor, masks.

    Raises:
        CalibrationError: Nothing to compare with, frames all the same, no light.
        DriverError: A device failed.
    """
    section = bundle.need("dark-flat", STEP)
    dark = Dark.of(section)
    bench.please(Arrangement.DARK)
    bench.progress.stage("dark frames", FRAMES)
    changes = _dark_changes(bench, section, dark)
    bench.please(Arrangement.FLAT)
    bench.progress.stage("flat frames", FRAMES)
    open_pattern = bench.flat_pattern(is_open=True)[None]
    flat = bench.grab(open_pattern, frames=FRAMES, exposure_s=float(section.facts["flat_exposure_s"]))
    changes += _flat_changes(flat, section, dark)
    if "sensor" in bundle:
        changes.append(_gain_change(flat, bundle.sections["sensor"], section, dark))
    if "masks" in bundle:
        bench.progress.stage("one mask")
        changes += _mask_changes(bench, bundle.sections["masks"])
    return changes


def _dark_changes(bench: Bench, section: Section, dark: Dark) -> list[Change]:
    shut = bench.flat_pattern(is_open=False)[None]
    stack = bench.grab(shut, frames=FRAMES, exposure_s=float(section.facts["dark_exposures_s"][0]))
    frames = stack.readings[0]
    check_stack(STEP, frames)
    pixels = frames[:, dark.good].astype(np.float64)
    shifts = pixels.mean(axis=0) - dark.at(stack.exposure_s)[dark.good]
    noise = section.number("dark_noise_rms_dn")
    now = float(np.sqrt(pixels.var(axis=0, ddof=1).mean()))
    doubt = float(section.estimates["dark_noise_rms_dn"].error) / noise
    return [
        Change(
            "black level",
            float(shifts.mean()),
            float(shifts.std()) / np.sqrt(shifts.size),
            OFFSET_LIMIT * noise,
            "DN",
            "dark-flat",
        ),
        Change(
            "dark noise",
            now / noise - 1,
            float(np.hypot(1 / np.sqrt(2 * shifts.size * (FRAMES - 1)), doubt)),
            NOISE_LIMIT,
            "1",
            "dark-flat",
        ),
    ]


def _flat_changes(flat: Stack, section: Section, dark: Dark) -> list[Change]:
    frames = flat.readings[0]
    check_stack(STEP, frames)
    signal = (frames.astype(np.float64) - dark.at(flat.exposure_s))[:, dark.good]
    mean = signal.mean(axis=0)
    typical = float(mean.mean())
    if typical < NO_LIGHT_DN:
        refuse_dark(STEP, typical)
    response = section.array("response").astype(np.float64)[dark.good]
    then = section.estimates["response"].standard_error.astype(np.float64)[dark.good]
    now = mean / typical * float(response.mean())
    noise = signal.var(axis=0, ddof=1).mean() / len(frames) / typical**2 + float(np.square(then).mean())
    total = float(np.square(now - response).mean())
    excess = float(np.sqrt(max(total - noise, 0.0)))
    error = total * float(np.sqrt(2 / mean.size))
    rate = section.estimates["flat_dn_per_s"]
    return [
        Change(
            "response, rms over pixels",
            excess,
            float(min(error / (2 * excess) if excess else np.inf, np.sqrt(error))),
            RESPONSE_LIMIT,
            "1",
            "dark-flat",
        ),
        Change(
            "brightness of the field",
            typical / flat.exposure_s / float(rate) - 1,
            float(rate.error) / float(rate),
            None,
            "1",
            "dark-flat",
        ),
    ]


def _gain_change(flat: Stack, sensor: Section, section: Section, dark: Dark) -> Change:
    pixels = flat.readings[0][:, dark.good].astype(np.float64)
    variance, freedom = noise_variance(pixels, pixels.mean(axis=0) - dark.at(flat.exposure_s)[dark.good])
    charge = float((pixels - dark.offset_dn[dark.good]).mean())
    shot = variance - section.number("dark_noise_rms_dn") ** 2
    gain = sensor.estimates["gain_e_per_dn"]
    # The present slope of the photon transfer curve; a non-linear response changes it (`transfer_curve`).
    bend, full = sensor.number("linearity_error"), sensor.number("saturation_dn") - float(dark.offset_dn.mean())
    foretold = charge / float(gain) * (1 + 4 * bend * (1 - 3 * charge / full))
    doubt = float(np.hypot(gain.error / float(gain), np.sqrt(2 / freedom) * variance / shot))
    return Change("gain", foretold / shot - 1, doubt, GAIN_LIMIT, "1", "sensor")


def _mask_changes(bench: Bench, masks: Section) -> list[Change]:
    seen = probe_mask(bench, masks)
    changes = [
        Change("one mask, rms over pixels", seen.difference, 0.0, DIFFERENCE_LIMIT, "1", "masks"),
        Change("correlation with it, less than 1 by", 1 - seen.correlation, 0.0, None, "1", "masks"),
    ]
    for name, shift, error in zip(("right", "down"), seen.shift_px, seen.shift_error_px, strict=True):
        if np.isfinite(error):
            changes.append(Change(f"modulator moved {name}", shift, error, SHIFT_LIMIT_PX, "px", "registration"))
    return changes
