"""Whether a bundle still fits a bench: same devices, same masks, same set-up, not too old.

Here: checks that need no frame. Not here: checks by frames (`probe`, `drift`), files (`bundle`).
"""

import hashlib
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Final

import numpy as np

from gs2ci.core.arrays import U8, U16
from gs2ci_calibration.bench import Bench
from gs2ci_calibration.bundle import Bundle, Provenance
from gs2ci_calibration.estimates import Section
from gs2ci_calibration.refusals import CalibrationError, Reason
from gs2ci_drivers.plan import CaptureSettings

STEP: Final = "check"
TIME_TOLERANCE: Final = 1e-3
"""Relative difference allowed between the time of a mask now and at calibration, for the devices' rounding."""
SIDES: Final = ("height", "width")
REMEDY: Final = "run `gs2ci calibrate all` again, or name the bundle of this bench"


@dataclass(frozen=True)
class Fit:
    """The result of the check.

    Args:
        misfits: Sentences, each a reason not to use the bundle.
        notes: Further remarks, which are no such reason.
    """

    misfits: tuple[str, ...]
    notes: tuple[str, ...]

    def require(self, bundle: Bundle) -> None:
        """Raise an error unless the bundle fits.

        Raises:
            CalibrationError: It does not; every reason is named.
        """
        if self.misfits:
            raise CalibrationError(
                STEP, Reason.DOES_NOT_FIT, f"{bundle.path or 'bundle'}: {'; '.join(self.misfits)}", remedy=REMEDY
            )


def codes_sha256(codes: U16) -> U8:
    """Return the hash that identifies the codes [N, h, w] of a bundle's masks, [32] uint8."""
    digest = hashlib.sha256(str(codes.shape).encode() + np.ascontiguousarray(codes, dtype="<u2").tobytes()).digest()
    return np.frombuffer(digest, np.uint8)


def needed(known: Bundle, name: str, bench: Bench, step: str) -> Section:
    """Return a section that a step requires, measured with the sensor as it is set up now.

    Raises:
        CalibrationError: It is missing (`Reason.NEEDS`), or of another size, region, range or gain
            (`Reason.DOES_NOT_FIT`).
    """
    section = known.need(name, step)
    other = _setup(section, bench)
    if other:
        raise CalibrationError(
            step,
            Reason.DOES_NOT_FIT,
            f"{known.path or 'bundle'}: {'; '.join(other)}",
            allowed="sections measured with the sensor as it is set up now",
            remedy=f"run `gs2ci calibrate {name}` again",
        )
    return section


def fit(bundle: Bundle, bench: Bench, provenance: Provenance, max_age_days: float) -> Fit:
    """Compare a bundle with the connected bench and with the capture that is planned on it; nothing moves.

    Args:
        bundle: The bundle; without masks only the rest is compared.
        bench: The bench, connected.
        provenance: Its devices' identities.
        max_age_days: Age from which on a section is too old.

    Raises:
        DriverError: A device does not answer.
    """
    old = [_age(section, max_age_days, datetime.now(UTC)) for section in bundle.sections.values()]
    other = [sentence for section in bundle.sections.values() for sentence in _setup(section, bench)]
    misfits = [*_devices(bundle.provenance, provenance), *filter(None, old), *other]
    if "masks" in bundle:
        misfits += _masks(bundle.sections["masks"], bench)
    texts = {
        name: bundle.provenance.rig if section.rig is None else section.rig for name, section in bundle.sections.items()
    }
    said = {text: _said_of_the_bench(text) for text in {provenance.rig, *texts.values()}}  # most sections have the same
    changed = [name for name, text in texts.items() if said[text] != said[provenance.rig]]
    notes = []
    if changed:
        wholly = len(changed) == len(bundle.sections)
        since = "the calibration" if wholly else f"the measurement of {', '.join(changed)}"
        notes.append(f"the rig file has changed since {since}")
    if "masks" in bundle and not of_these_times(bundle.sections["masks"], bench.capture):
        notes.append("the weights of the masks were measured with other times in [capture], and those planned are used")
    dark = bundle.sections.get("dark-flat")
    before, after = None if dark is None else dark.temperature_c, provenance.temperature_c
    if before is not None and after is not None and abs(before - after) > 5:
        notes.append(f"the sensor was at {before:.0f} °C and is at {after:.0f} °C: its dark current has changed")
    return Fit(tuple(misfits), tuple(notes))


def times_of(capture: CaptureSettings) -> dict[str, float]:
    """Return the times, s, on which the weights of the masks depend, as a section states them in its facts."""
    return {"mask_s": capture.mask_s, "dark_s": capture.dark_s, "margin_s": capture.margin_s}


def of_these_times(section: Section, capture: CaptureSettings) -> bool:
    """Tell whether the weights of a section are those of a capture, as far as it states its times."""
    slack_s = TIME_TOLERANCE * capture.mask_s
    return all(abs(float(section.facts.get(name, now)) - now) <= slack_s for name, now in times_of(capture).items())


def _said_of_the_bench(rig: str) -> Any:
    """Return the tables of a rig file's text, without the bundle's own name, which is entered after calibration."""
    try:
        tables = tomllib.loads(rig)
    except (tomllib.TOMLDecodeError, RecursionError):  # a damaged or foreign text is compared as it is
        return rig
    about = tables.get("calibration", {})
    rest = {key: value for key, value in about.items() if key != "bundle"} if isinstance(about, dict) else about
    return {**tables, "calibration": rest}


def _devices(then: Provenance, now: Provenance) -> Sequence[str]:
    found = []
    for name, (model, serial, _) in then.devices.items():
        there = now.devices.get(name)
        if there is None:
            # Masks and sensor do not depend on a stage that is missing now.
            continue
        if there[:2] != (model, serial):
            found.append(f"its {name} is {f'{model} {serial}'.strip()}, this one is {f'{there[0]} {there[1]}'.strip()}")
    return found


def _age(section: Section, max_age_days: float, now: datetime) -> str:
    try:
        age = now - datetime.fromisoformat(section.measured_utc)
    except (ValueError, TypeError):  # not a date, or one without a time zone
        return f"{section.name} has no date"
    if age > timedelta(days=max_age_days):
        return f"{section.name} is {age.days} days old, allowed are {max_age_days:g}"
    return ""


def _setup(section: Section, bench: Bench) -> Sequence[str]:
    """Compare the sensor's set-up with the one that a section states; a section states what it depends on."""
    facts, its, found = section.facts, f"its section {section.name}", []
    size = tuple(facts.get("size", [facts.get(side, own) for side, own in zip(SIDES, bench.size, strict=True)]))
    if "offset_dn" in section.estimates:
        size = section.array("offset_dn").shape
    if size != bench.size:
        found.append(f"{its} is of {size[0]} x {size[1]} pixels, the capture of {bench.size[0]} x {bench.size[1]}")
    if facts.get("region", bench.region) != bench.region:
        found.append(f"{its} is of the region at {_place(facts['region'])}, the capture at {_place(bench.region)}")
    if facts.get("top_dn", bench.top_dn) != bench.top_dn:
        found.append(f"{its}: readings end at {facts['top_dn']} DN, those of the capture at {bench.top_dn}")
    if "gain_db" in facts and facts["gain_db"] != bench.config.gain_db:
        found.append(f"{its} was taken at a gain of {facts['gain_db']} dB, not {bench.config.gain_db}")
    return found


def _place(region: Sequence[int | None]) -> str:
    return ", ".join(
        f"{name} {'in the middle' if first is None else first}"
        for name, first in zip(("row", "column"), region, strict=True)
    )


def _masks(section: Section, bench: Bench) -> Sequence[str]:
    found = []
    masks = section.array("masks")
    if masks.shape != (len(bench.codes), *bench.size):
        found.append(f"its masks are {list(masks.shape)}, the capture's {[len(bench.codes), *bench.size]}")
    elif not np.array_equal(section.arrays.get("patterns_sha256", ()), codes_sha256(bench.codes)):
        found.append("its masks are of other patterns")
    mask_s = float(section.facts.get("mask_s", bench.capture.mask_s))
    if abs(mask_s - bench.capture.mask_s) > TIME_TOLERANCE * mask_s:
        found.append(f"its masks are shown for {mask_s * 1e3:g} ms, the capture's for {bench.capture.mask_s * 1e3:g}")
    return found
