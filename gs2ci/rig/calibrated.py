"""The calibration bundle that a capture uses: found, checked against the bench, and turned into what a shot file holds.

Here: `bundle_of` (which bundle), `load` (does it fit, a probe of one mask) and `Calibrated`, which `recording`
writes. Not here: measuring (`gs2ci_calibration`), the file's layout (`gs2ci.core.storage`).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.progress import Progress, Silent
from gs2ci.rig.calibrating import TerminalOperator, bench_of, provenance_of
from gs2ci.rig.opening import Rig
from gs2ci_calibration.bundle import Bundle, read_bundle
from gs2ci_calibration.estimates import Section
from gs2ci_calibration.fitting import STEP, fit, of_these_times
from gs2ci_calibration.frames import Dark, by_colour
from gs2ci_drivers.acquisition import Devices
from gs2ci_drivers.plan import CaptureSettings

if TYPE_CHECKING:
    from gs2ci_calibration.probe import Probe


@dataclass(frozen=True)
class MeasuredAxis:
    """An axis of the stage as it was measured.

    Args:
        direction: Unit vector of the camera's motion in its own frame (x right, y down, z ahead), [3].
        scale: True mm per counted mm.
        speed_error: Relative error of a sweep's speed, beyond the scale at rest; 0 if none was measured.
        measured_utc: When, ISO 8601.
        backlash_mm: Lost motion at a reversal, counted mm, and its standard error.
        sweep_lag_s: Delay with which a position is counted during a sweep, and its standard error; None if not
            measured.
        repeatability_mm: Repeatability of a sweep's positions, counted mm, one standard deviation.
    """

    direction: F64
    scale: float
    speed_error: float
    measured_utc: str
    backlash_mm: tuple[float, float] = (0.0, 0.0)
    sweep_lag_s: tuple[float, float] | None = None
    repeatability_mm: float = 0.0

    @property
    def per_mm(self) -> F64:
        """Get the camera's motion per counted mm at rest, mm, [3]."""
        return np.asarray(self.scale * self.direction, np.float64)


@dataclass(frozen=True)
class Calibrated:
    """A bundle that fits the bench.

    Args:
        bundle: The bundle, which has masks.
        notes: Remarks on how it fits the bench.
        probe: The comparison of one mask, shown just before the capture, with the bundle; None if that was skipped.
        weights: The measured share of each mask's time that is exposed, [N]; None if none was measured with the times
            of the capture.
    """

    bundle: Bundle
    notes: tuple[str, ...]
    probe: "Probe | None" = None
    weights: F32 | None = None

    @property
    def masks(self) -> F32:
        """Get the transmissions in the order shown, [N, H, W] in [0, 1]; 0 at pixels where they are unknown."""
        masks = np.clip(self.bundle.sections["masks"].array("masks"), 0.0, 1.0)
        return np.where(self._known, masks, 0.0).astype(np.float32)

    @property
    def unusable(self) -> Bool:
        """Get the pixels whose readings cannot be used: dead, hot, or without a known mask, [H, W]."""
        dark = self._dark
        bad = ~self._known
        return bad if dark is None else bad | ~dark.good

    @property
    def per_pixel(self) -> bool:
        """Get whether dark and sensitivity are known for each pixel."""
        return self._dark is not None

    @property
    def saturation_dn(self) -> float | None:
        """Get the reading at which pixels may be clipped, by the photon transfer curve; None without that curve."""
        if "sensor" not in self.bundle:
            return None
        section, dark = self.bundle.sections["sensor"], self.bundle.sections.get("dark-flat")
        # Read noise and the pixels' own offsets scatter clipped pixels around their mean: four standard deviations
        # include all but one in 30 000.
        noise_dn = section.number("read_noise_e") / section.number("gain_e_per_dn")
        dsnu_dn = 0.0 if dark is None else dark.number("dsnu_dn")
        return section.number("saturation_dn") - 4 * float(np.hypot(noise_dn, dsnu_dn))

    @property
    def intrinsics(self) -> F64 | None:
        """Get the measured camera matrix, [3, 3], or None."""
        return self.bundle.sections["camera"].array("intrinsics") if "camera" in self.bundle else None

    @property
    def distortion(self) -> F64 | None:
        """Get the measured distortion coefficients, [5], or None."""
        return self.bundle.sections["camera"].array("distortion") if "camera" in self.bundle else None

    @property
    def late_s(self) -> tuple[float, float] | None:
        """Get the measured delay from an edge to its exposure and the standard error, or None."""
        return self._timing("latency_s")

    @property
    def longer_s(self) -> tuple[float, float] | None:
        """Get the measured excess of an exposure over the configured one and the standard error, or None."""
        return self._timing("exposure_offset_s")

    def _timing(self, name: str) -> tuple[float, float] | None:
        section = self.bundle.sections.get("timing")
        return None if section is None else _pair(section, name)

    @property
    def axes(self) -> dict[str, MeasuredAxis]:
        """Get the measured axes of the stage, by name."""
        if "stage" not in self.bundle:
            return {}
        section = self.bundle.sections["stage"]
        names = [key.removeprefix("direction_") for key in section.estimates if key.startswith("direction_")]
        return {name: _axis(section, name) for name in names}

    def arrays(self, exposure_s: float, *, mosaic: bool) -> dict[str, NDArray[Any]]:
        """Return the other arrays of a calibration that a shot file stores, by their keys there.

        Args:
            exposure_s: Exposure of the capture: the dark reading grows with it.
            mosaic: Whether pixels stand behind a colour filter array: each colour's sensitivity then has a mean of 1.
        """
        found: dict[str, NDArray[Any]] = {"masks/contrast": self.bundle.sections["masks"].array("contrast")}
        dark = self._dark
        if dark is not None:
            found["calib/dark"] = dark.at(exposure_s)
            found["calib/flat"] = self._flat(dark, mosaic=mosaic)
        if "registration" in self.bundle:
            found["calib/affine"] = self.bundle.sections["registration"].array("sensor_from_modulator")
        return found

    def record(self) -> dict[str, Any]:
        """Return a summary of the bundle for the shot file's events."""
        told: dict[str, Any] = {
            "bundle": str(self.bundle.path),
            "created_utc": self.bundle.created_utc,
            "sections": {name: section.measured_utc for name, section in self.bundle.sections.items()},
            "notes": list(self.notes),
        }
        if self.probe is not None:
            told["probe"] = {"difference": self.probe.difference, "shift_px": list(self.probe.shift_px)}
        return told

    @property
    def _dark(self) -> Dark | None:
        return Dark.of(self.bundle.sections["dark-flat"]) if "dark-flat" in self.bundle else None

    @property
    def _known(self) -> Bool:
        return self.bundle.sections["masks"].known

    def _flat(self, dark: Dark, *, mosaic: bool) -> F64:
        flat = self.bundle.sections["dark-flat"].array("response").astype(np.float64)
        if mosaic:
            flat /= by_colour(flat, ~dark.dead, np.mean)
        return np.where(dark.dead, 1.0, flat)


def _axis(section: Section, name: str) -> MeasuredAxis:
    speed = f"velocity_error_{name}"
    backlash, repeatability = _pair(section, f"backlash_mm_{name}"), _pair(section, f"repeatability_mm_{name}")
    return MeasuredAxis(
        direction=np.asarray(section.array(f"direction_{name}"), np.float64),
        scale=section.number(f"scale_{name}"),
        speed_error=section.number(speed) if speed in section.estimates else 0.0,
        measured_utc=section.measured_utc,
        backlash_mm=backlash or (0.0, 0.0),
        sweep_lag_s=_pair(section, f"sweep_lag_s_{name}"),
        repeatability_mm=0.0 if repeatability is None else repeatability[0],
    )


def _pair(section: Section, name: str) -> tuple[float, float] | None:
    """Return a number of a section and its standard error; None where it was not measured."""
    estimate = section.estimates.get(name)
    return None if estimate is None else (float(estimate), estimate.error)


def bundle_of(rig: Rig, path: Path | None) -> Bundle | None:
    """Read the bundle of a rig; no device is needed.

    Args:
        rig: The rig; its [calibration] `bundle` names one beside the rig file.
        path: Another bundle; None takes the rig's.

    Returns:
        The bundle, or None if the rig names none.

    Raises:
        CalibrationError: It has no masks.
        StorageError: It cannot be read.
    """
    named = rig.table.calibration.bundle
    if path is None and not named:
        return None
    bundle = read_bundle(path or rig.folder / named)
    bundle.need("masks", STEP)
    return bundle


def load(
    rig: Rig, devices: Devices, bundle: Bundle, *, probe: bool = True, progress: Progress | None = None
) -> Calibrated:
    """Check that a bundle still fits the bench, and compare one mask with it.

    Args:
        rig: The rig.
        devices: Its open devices.
        bundle: From `bundle_of`.
        probe: Whether to show one mask and compare it; otherwise nothing is uploaded.
        progress: Receives the stages and steps.

    Raises:
        CalibrationError: It does not fit, or the mask shown differs from the one that it states.
        DriverError: A device failed.
    """
    progress = progress or Silent()
    masks = bundle.need("masks", STEP)
    bench = bench_of(rig, devices, TerminalOperator(progress.say))
    found = fit(bundle, bench, provenance_of(rig, devices), rig.table.calibration.max_age_days)
    found.require(bundle)
    for note in found.notes:
        progress.say(note)
    seen = None
    if probe:
        # A capture without a bundle does without SciPy.
        from gs2ci_calibration.probe import probe_mask  # noqa: PLC0415

        seen = probe_mask(bench, masks).require()
    return Calibrated(bundle, found.notes, seen, _weights(bundle, bench.capture))


def _weights(bundle: Bundle, capture: CaptureSettings) -> F32 | None:
    """Return the weights of the masks with a capture's times: those measured by light, otherwise those of `timing`."""
    masks, timing = bundle.sections["masks"], bundle.sections.get("timing")
    by_light = masks.facts.get("weights", "measured") == "measured"
    for section in (masks,) if by_light else (timing, masks):
        if section is not None and "weights" in section.estimates and of_these_times(section, capture):
            return section.array("weights").astype(np.float32)
    return None
