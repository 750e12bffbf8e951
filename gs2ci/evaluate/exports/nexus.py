"""A run as a NeXus file (HDF5): views and depth as NXdata, cameras, operator, sample, and program.

Groups and attributes are those of the NeXus standard (manual.nexusformat.org: NXroot, NXentry, NXdata, NXuser,
NXsample, NXinstrument, NXdetector, NXcollection), so that a viewer finds by itself what to plot: `default` leads from
the root to the entry to the data, and `signal` names the array. No application definition fits, and none is claimed.

Here: `write_nexus`. Not here: where the figures come from.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np

from gs2ci import __version__
from gs2ci.core.arrays import F32, F64
from gs2ci.core.whole_file import write_whole
from gs2ci.evaluate.points import Cameras
from gs2ci.evaluate.report import Report

# Units are those of UDUNITS, "" where there is none (NeXus manual, "NeXus Data Units"; nxdlTypes, NX_UNITLESS).
_KNOWN_UNITS: Final = ("mm",)
CHANNELS: Final = ("red", "green", "blue")
# Places in standard groups for the operator's entries of these names.
_PLACES: Final = {
    "operator": ("user", "NXuser", "name"),
    "institution": ("user", "NXuser", "affiliation"),
    "sample": ("sample", "NXsample", "name"),
}


def write_nexus(path: Path, report: Report, views: F32, depth: F32 | None, cameras: Cameras) -> None:
    """Write a run.

    Args:
        path: The file.
        report: Of the run: its name, and what its provenance says of the exposure (`taken_at`, `metadata`).
        views: [N, H, W, C], full scale 1.
        depth: [N, H, W] in the unit of the path, 0 where nothing is seen; None where there is none.
        cameras: Of the views.

    Raises:
        StorageError: The file cannot be written.
    """
    given = report.provenance.get("metadata")
    metadata: Mapping[str, Any] = given if isinstance(given, dict) else {}
    # In memory: HDF5 reports a disk that refuses by errors of many kinds.
    with h5py.File(path.name, "w", driver="core", backing_store=False) as file:
        file.attrs["NX_class"] = "NXroot"
        file.attrs["default"] = "entry"
        file.attrs["creator"] = f"gs2ci {__version__}"
        entry = _group(file, "entry", "NXentry")
        entry.attrs["default"] = "views"
        entry["title"] = report.name
        entry["program_name"] = "gs2ci"
        entry["program_name"].attrs["version"] = __version__
        if "taken_at" in report.provenance:
            entry["start_time"] = str(report.provenance["taken_at"])
        if "experiment" in metadata:
            entry["experiment_identifier"] = str(metadata["experiment"])
        unit = report.length_unit
        _data(entry, "views", views, ("view", "y", "x", "channel"), "1", "views of one exposure, full scale 1")
        if depth is not None:
            said = f"distance along the optical axis in {unit}, 0: unknown"
            _data(entry, "depth", depth, ("view", "y", "x"), unit if unit in _KNOWN_UNITS else "", said)
        _instrument(entry, cameras, views.shape, unit)
        _write_metadata(entry, metadata)
        notes = _group(entry, "notes", "NXnote")
        notes["description"], notes["type"], notes["data"] = "the run's report", "application/json", report.text()
        file.flush()
        content = file.id.get_file_image()
    write_whole(path, content)


def _group(parent: Any, name: str, kind: str) -> Any:
    made = parent.require_group(name)
    made.attrs["NX_class"] = kind
    return made


def _data(entry: Any, name: str, values: F32, axes: Sequence[str], units: str, title: str) -> None:
    """Write an array as NXdata, its axes counted from 0, pixel centres at + 0.5."""
    group = _group(entry, name, "NXdata")
    group.attrs["signal"] = name
    group.attrs["axes"] = list(axes)
    group["title"] = title
    group.create_dataset(name, data=values, compression="gzip", shuffle=True)
    group[name].attrs["units"], group[name].attrs["long_name"] = units, title
    for index, axis in enumerate(axes):
        group.attrs[f"{axis}_indices"] = index
        if axis == "channel":
            count = values.shape[index]
            group[axis] = list(CHANNELS) if count == len(CHANNELS) else [f"channel {i}" for i in range(count)]
        else:
            centre = 0.5 if axis in ("x", "y") else 0
            group[axis] = np.arange(values.shape[index]) + centre
            group[axis].attrs["units"] = ""
            group[axis].attrs["long_name"] = f"{axis}, px" if axis in ("x", "y") else axis


def _instrument(entry: Any, cameras: Cameras, shape: tuple[int, ...], unit: str) -> None:
    instrument = _group(entry, "instrument", "NXinstrument")
    instrument["name"] = "snapshot compressive camera"
    detector = _group(instrument, "detector", "NXdetector")
    detector["description"] = f"{shape[0]} masks in one exposure, {shape[1]} x {shape[2]} px"
    # NeXus has no class for a pinhole: a collection may hold anything, and each array says what it is.
    found = _group(detector, "cameras", "NXcollection")
    arrays: dict[str, tuple[F64 | None, str]] = {
        "world_to_camera": (
            cameras.world_to_camera,
            f"[view, 4, 4], OpenCV axes: x right, y down, z ahead; lengths in {unit}",
        ),
        "intrinsics": (cameras.intrinsics, "[3, 3] px, the centre of the first pixel at 0.5"),
        "distortion": (cameras.distortion, "k1, k2, p1, p2, k3, as OpenCV has them"),
    }
    for name, (values, what) in arrays.items():
        if values is not None:
            found[name] = values
            found[name].attrs["description"] = what


def _write_metadata(entry: Any, metadata: Mapping[str, Any]) -> None:
    """Write the operator's metadata: where the standard has a place, there; all of it in a collection as well."""
    for key, (group, kind, field) in _PLACES.items():
        if key in metadata:
            _group(entry, group, kind)[field] = str(metadata[key])
    if metadata:
        kept = _group(entry, "metadata", "NXcollection")
        for key, value in metadata.items():
            kept.attrs[key] = value
