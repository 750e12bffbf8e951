"""The calibration bundle `bench.cal.h5`, schema gs2ci.calibration/1: the measured properties of a bench, by sections.

    /                            attrs: schema, created_utc, software
    /complete                    u1 scalar, 1
    /provenance                  JSON: rig_sha256, rig (text of the rig file), devices, simulated, temperature_c
    /sections/NAME/record        JSON: measured_utc, facts, notes, units {estimate: unit}; rig, temperature_c as above,
                                 at the time of the measurement
    /sections/NAME/estimates/KEY/value, standard_error     f8 or f4, any shape
    /sections/NAME/arrays/KEY    numbers of any kind

A section replaces an older one of its name; the others stay. The provenance is that of the last section added; each
section keeps the rig file and the temperature of its own measurement. Every write makes a complete new file beside the
old one and renames it (`gs2ci.core.storage.sealing`): a crash leaves either the old bundle or the new one. No NaN is
ever written, and a file that contains one is refused.

The sections, and the values that other modules read from them (shapes: H, W sensor; Hm, Wm modulator; N masks):

    dark-flat     offset_dn [H, W], dark_current_dn_per_s [H, W], dark_noise_dn [H, W], response [H, W] (mean 1: PRNU
                  and fall-off together), dark_noise_rms_dn, dsnu_dn, prnu, flat_dn_per_s; arrays hot, dead [H, W] u1;
                  facts top_dn, gain_db, region, flat_exposure_s, dark_exposures_s
    sensor        gain_e_per_dn, read_noise_e, full_well_e, saturation_dn, linearity_error, linear_to_dn; arrays
                  curve_signal_dn, curve_variance_dn2, curve_exposure_s [L]; facts limited_by, top_dn, gain_db
    timing        latency_s, jitter_s, exposure_offset_s, weights [N] (overlap of each mask with the exposure); facts
                  mask_s, mode
    masks         masks [N, H, W] f4 transmissions in the order shown, leakage included, contrast [H, W] f4 (off over
                  on), weights [N], prediction_error_rms; arrays patterns_sha256 [32] u1 of the codes [N, h, w] as
                  drawn, valid [H, W] u1; facts mode, frames, order, polarity, mask_s, region
    registration  sensor_from_modulator [2, 3] (x right, y down, pixel centres at +0.5), modulator_from_sensor [K, 2]
                  (a polynomial's coefficients), psf_sigma_px, psf_kernel; facts orientation, degree, size, region
    camera        intrinsics [3, 3], distortion [5] (OpenCV's k1 k2 p1 p2 k3); facts height, width, region
    stage         for each axis A: direction_A [3] in the camera frame, scale_A, backlash_mm_A, repeatability_mm_A,
                  velocity_error_A, sweep_lag_s_A

Here: the file. Not here: the contents of a section (the procedures), whether a bundle still fits a bench (`fitting`).
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from gs2ci import __version__
from gs2ci.core.alone import alone_in
from gs2ci.core.errors import NumericsError, StorageError, room_after
from gs2ci.core.hdf5 import SuspectFile, check_text_heaps
from gs2ci.core.storage.layout import to_json
from gs2ci.core.storage.sealing import check_manifest_place, check_room, partial_of, seal
from gs2ci.core.whole_file import check_place
from gs2ci_calibration.estimates import Estimate, Section
from gs2ci_calibration.refusals import CalibrationError, Reason

SCHEMA: Final = "gs2ci.calibration/1"
AXES_MAX: Final = 4
REMEDY: Final = "calibrate again, or copy the bundle again from its source"


@dataclass(frozen=True)
class Provenance:
    """Which bench a bundle belongs to.

    Args:
        rig: Text of the rig file, of the last measurement.
        devices: For each device its model, serial number and firmware or driver.
        simulated: Whether the bench was simulated.
        temperature_c: Temperature of the sensor at the last measurement, or None if unknown.
    """

    rig: str = ""
    devices: Mapping[str, tuple[str, str, str]] = field(default_factory=dict)
    simulated: bool = False
    temperature_c: float | None = None

    @property
    def rig_sha256(self) -> str:
        """Get the hash of the rig file's text."""
        return hashlib.sha256(self.rig.encode()).hexdigest()


@dataclass(frozen=True)
class Bundle:
    """The measured properties of a bench.

    Args:
        provenance: Which bench.
        sections: Its sections by name.
        created_utc: When the bundle was created, ISO 8601.
        path: The file it was read from, for messages; None if it was not read from one.
    """

    provenance: Provenance = field(default_factory=Provenance)
    sections: Mapping[str, Section] = field(default_factory=dict)
    created_utc: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    path: Path | None = None

    def __contains__(self, name: str) -> bool:
        """Return whether there is a section of this name."""
        return name in self.sections

    def _repr_png_(self) -> bytes | None:
        """Show the first and the last mask as measured, and the sensor's response, if they are known."""
        from gs2ci.core.notebook import png_of, row_of  # noqa: PLC0415  pictures are drawn only when shown

        shown: list[NDArray[Any]] = []
        if "masks" in self:
            masks = self.sections["masks"].array("masks")
            shown += [masks[0], masks[-1]]
        if "dark-flat" in self:
            # The response has a mean of 1: half of full scale shows both sides of it.
            shown.append(0.5 * self.sections["dark-flat"].array("response"))
        return png_of(row_of(shown)) if shown else None

    def _repr_html_(self) -> str:
        from gs2ci.core.notebook import sheet  # noqa: PLC0415  as above

        rows = [
            (section.name if first else "", name, estimate, section.measured_utc if first else "")
            for section in self.sections.values()
            for first, (name, estimate) in zip(
                [True] + [False] * len(section.estimates), section.estimates.items(), strict=False
            )
        ]
        kind = "simulated bench" if self.provenance.simulated else "bench"
        title = f"calibration of a {kind}, begun {self.created_utc}"
        return sheet(title, ("section", "found", "value ± standard error", "measured"), rows, self._repr_png_())

    def need(self, name: str, step: str) -> Section:
        """Return a section that a step requires.

        Raises:
            CalibrationError: It is missing (`Reason.NEEDS`).
        """
        if name not in self.sections:
            raise CalibrationError(
                step,
                Reason.NEEDS,
                f"the bundle has no section {name!r}",
                allowed=f"a bundle with {name!r}; this one has {', '.join(self.sections) or 'nothing'}",
                remedy=f"run `gs2ci calibrate {name}` first",
            )
        return self.sections[name]

    def with_section(self, section: Section) -> "Bundle":
        """Return the bundle with a section added, or replaced."""
        return replace(self, sections={**self.sections, section.name: section})


def check_bundle_place(path: Path) -> None:
    """Check that a bundle can be written there; to be called before anything is measured.

    Raises:
        StorageError: The name or folder cannot be used, or another program's file has the name of its manifest.
    """
    if path.suffix != ".h5" or not path.parent.is_dir():
        raise StorageError(f"{path}: not a place for a bundle", allowed="a name that ends in .h5, in a folder there is")
    check_manifest_place(path)
    check_place(path)


def write_bundle(path: Path, bundle: Bundle) -> Path:
    """Write a bundle, completely or not at all; an older one of that name is replaced.

    Raises:
        NumericsError: A number is not finite.
        StorageError: The file cannot be written.
    """
    check_bundle_place(path)
    with alone_in(path.parent):
        return _replaced(path, bundle)


def _replaced(path: Path, bundle: Bundle) -> Path:
    """Write a bundle where nothing else writes."""
    for section in bundle.sections.values():
        _check_section(section)
    partial = partial_of(path)
    check_room(partial, _bytes_of(bundle))
    try:
        with h5py.File(partial, "w") as file:
            _write(file, bundle)
    except BaseException as error:
        partial.unlink(missing_ok=True)
        if isinstance(error, OSError | RuntimeError):  # HDF5 reports a full disk as either
            raise StorageError(
                f"{path}: cannot be written: {error}", remedy=f"{room_after(error)}, check the folder"
            ) from error
        raise
    seal(partial, path)
    return path


def check_target(path: Path, provenance: Provenance, step: str) -> None:
    """Check that a section can be added to a bundle, before any frame is taken for it.

    Args:
        path: File of the bundle, which may exist or not.
        provenance: Provenance of the bench.
        step: The step that will be measured, for messages.

    Raises:
        CalibrationError: The bundle belongs to other devices (`Reason.DOES_NOT_FIT`).
        StorageError: No bundle can be written there, or the file there is no bundle.
    """
    check_bundle_place(path)
    if path.exists():
        _check_devices(path, read_bundle(path), provenance, step)


def add_section(path: Path, section: Section, provenance: Provenance) -> Bundle:
    """Add a section to the bundle at `path`, which is created if missing; return the bundle.

    Raises:
        CalibrationError: The bundle belongs to other devices (`Reason.DOES_NOT_FIT`).
        NumericsError, StorageError: As `write_bundle` and `read_bundle`.
    """
    check_bundle_place(path)
    with alone_in(path.parent):  # a section that another process adds between reading and writing would be lost
        bundle = read_bundle(path) if path.exists() else Bundle(provenance)
        _check_devices(path, bundle, provenance, section.name)
        of_this_rig = replace(section, rig=provenance.rig, temperature_c=provenance.temperature_c)
        whole = replace(bundle.with_section(of_this_rig), provenance=provenance, path=path)
        _replaced(path, whole)
    return whole


def read_bundle(path: Path) -> Bundle:
    """Read a bundle.

    Raises:
        StorageError: Missing, truncated, damaged, of another schema, or with a number that is not finite.
    """
    with _opened(path) as reader:
        provenance = _provenance(_json(reader, "provenance"))
        sections = {name: _read_section(reader, name, provenance) for name in reader.keys("sections")}
        created = reader.file.attrs.get("created_utc", "")
        ordered = dict(sorted(sections.items(), key=lambda item: item[1].measured_utc))
        return Bundle(provenance, ordered, str(created), path)


def _check_devices(path: Path, bundle: Bundle, provenance: Provenance, step: str) -> None:
    if dict(bundle.provenance.devices) != dict(provenance.devices):
        raise CalibrationError(
            step,
            Reason.DOES_NOT_FIT,
            f"{path} belongs to {_named(bundle.provenance)}, the bench has {_named(provenance)}",
            remedy="write to another bundle, and calibrate all of it",
        )


def _named(provenance: Provenance) -> str:
    return ", ".join(f"{model} {serial}".strip() for model, serial, _ in provenance.devices.values()) or "no device"


def _check_section(section: Section) -> None:
    for name, array in section.arrays.items():
        if array.dtype.kind not in "uif" or not np.isfinite(array).all():
            raise NumericsError(f"array {name!r} of section {section.name!r} is not made of finite numbers")


def _bytes_of(bundle: Bundle) -> int:
    """Return how many bytes the numbers of a bundle take at most; compression makes it less."""
    sections = bundle.sections.values()
    estimates = [estimate for section in sections for estimate in section.estimates.values()]
    arrays = [array for section in sections for array in section.arrays.values()]
    return sum(one.value.nbytes + one.standard_error.nbytes for one in estimates) + sum(one.nbytes for one in arrays)


def _write(file: h5py.File, bundle: Bundle) -> None:
    file.attrs["schema"] = SCHEMA
    file.attrs["created_utc"] = bundle.created_utc
    file.attrs["software"] = f"gs2ci {__version__}"
    told = bundle.provenance
    record = {
        "rig_sha256": told.rig_sha256,
        "rig": told.rig,
        "devices": {name: list(names) for name, names in told.devices.items()},
        "simulated": told.simulated,
        "temperature_c": told.temperature_c,
    }
    _text(file, "provenance", record)
    for name, section in bundle.sections.items():
        group = file.create_group(f"sections/{name}")
        units = {key: estimate.unit for key, estimate in section.estimates.items()}
        _text(
            group,
            "record",
            {
                "measured_utc": section.measured_utc,
                "facts": dict(section.facts),
                "notes": list(section.notes),
                "units": units,
                "rig": section.rig,
                "temperature_c": section.temperature_c,
            },
        )
        for key, estimate in section.estimates.items():
            _numbers(group, f"estimates/{key}/value", estimate.value)
            _numbers(group, f"estimates/{key}/standard_error", estimate.standard_error)
        for key, array in section.arrays.items():
            _numbers(group, f"arrays/{key}", array)
    file.create_dataset("complete", data=np.uint8(1))


def _text(group: h5py.Group, key: str, record: Mapping[str, Any]) -> None:
    group.create_dataset(key, data=to_json(record, key), dtype=h5py.string_dtype())


def _numbers(group: h5py.Group, key: str, array: NDArray[Any]) -> None:
    # Masks take most of the room; small arrays gain nothing.
    packing = {"compression": "gzip", "shuffle": True, "fletcher32": True} if array.size > 1024 else {}
    group.create_dataset(key, data=array, **packing)


@contextmanager
def _opened(path: Path) -> Iterator[SuspectFile]:
    """Open a bundle; turn any error inside the block into a StorageError."""
    if not path.is_file():
        raise StorageError(f"{path}: no such bundle", remedy="make one with `gs2ci calibrate all`")
    try:
        if not h5py.is_hdf5(path):
            raise StorageError(f"{path}: not an HDF5 file", allowed=f"a bundle, schema {SCHEMA}", remedy=REMEDY)
        check_text_heaps(path)
        with h5py.File(path, "r") as file:
            schema = file.attrs.get("schema")
            if schema != SCHEMA:
                shots = str(schema).startswith("gs2ci.capture/")
                remedy = "it holds exposures: give the file that `gs2ci calibrate` wrote" if shots else REMEDY
                raise StorageError(f"{path}: schema {schema!r}", allowed=f"schema {SCHEMA}", remedy=remedy)
            reader = SuspectFile(path, file)
            if int(reader.require("complete", axes=0)) != 1:
                raise StorageError(f"{path}: never finished", remedy=REMEDY)
            yield reader
    except StorageError:
        raise
    except NumericsError as error:
        raise StorageError(f"{path}: {error.problem}", allowed="finite numbers", remedy=REMEDY) from error
    except Exception as error:
        # HDF5 reports damage as almost any built-in exception; all of them mean the same to the user.
        detail = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise StorageError(f"{path}: cut short, damaged or locked: {detail}", remedy=REMEDY) from error


def _json(reader: SuspectFile, key: str) -> dict[str, Any]:
    record = json.loads(reader.text(key) or "null")
    if not isinstance(record, dict):
        raise reader.wrong(key, "not a JSON object")
    return record


def _provenance(record: Mapping[str, Any]) -> Provenance:
    devices = {str(name): (str(a), str(b), str(c)) for name, (a, b, c) in record.get("devices", {}).items()}
    return Provenance(
        rig=str(record.get("rig", "")),
        devices=devices,
        simulated=bool(record.get("simulated", False)),
        temperature_c=_temperature_c(record),
    )


def _temperature_c(record: Mapping[str, Any]) -> float | None:
    temperature = record.get("temperature_c")
    return None if temperature is None else float(temperature)


def _read_section(reader: SuspectFile, name: str, last: Provenance) -> Section:
    at = f"sections/{name}"
    record = _json(reader, f"{at}/record")
    # Bundles of earlier versions, and those written whole, state both once for all sections.
    alone = record.get("rig") is not None
    units = record.get("units", {})
    estimates = {
        key: Estimate(
            _array(reader, f"{at}/estimates/{key}/value"),
            _array(reader, f"{at}/estimates/{key}/standard_error"),
            str(units.get(key, "1")),
        )
        for key in reader.keys(f"{at}/estimates")
    }
    arrays = {key: _array(reader, f"{at}/arrays/{key}") for key in reader.keys(f"{at}/arrays")}
    section = Section(
        name=name,
        estimates=estimates,
        arrays=arrays,
        facts=dict(record.get("facts", {})),
        notes=tuple(str(note) for note in record.get("notes", [])),
        measured_utc=str(record.get("measured_utc", "")),
        rig=str(record["rig"]) if alone else last.rig,
        temperature_c=_temperature_c(record) if alone else last.temperature_c,
    )
    _check_section(section)
    return section


def _array(reader: SuspectFile, key: str) -> NDArray[Any]:
    dataset = reader.numbers(key)
    axes = AXES_MAX if dataset is None else min(dataset.ndim, AXES_MAX)
    return reader.require(key, axes=axes)
