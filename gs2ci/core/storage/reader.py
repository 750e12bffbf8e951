"""Reading capture files that may be anything: unfinished, damaged, from elsewhere, or made to do harm.

Here: `read_shot`, `count_shots`, `read_calibration`, and `CaptureFile`, through which all of them (and `recover`)
look at a file. Whatever is wrong ends in one StorageError that names file and key. A reader follows no links,
opens no second file, and knows how many bytes an array takes before it makes room for them.
Anyone may use the functions through `gs2ci.core.storage`; `CaptureFile` is for that package alone.
"""

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.errors import Gs2ciError, StorageError
from gs2ci.core.hdf5 import check_text_heaps
from gs2ci.core.records import Shot, Truth
from gs2ci.core.storage.layout import CALIBRATION, NO_MAP, SCHEMA, unpack, usable_per_pixel
from gs2ci.core.storage.sealing import PARTIAL

LIMIT_BYTES: Final = 4 * 2**30
# Deflate cannot shrink more than 1032:1 (its longest match is 258 bytes, coded in 2 bits), so an array that claims
# more bytes than this times the whole file was never written by us.
DEFLATE_LIMIT: Final = 1032
TEXT_LIMIT_BYTES: Final = 16 * 2**20


def count_shots(path: Path) -> int:
    """Count the whole shots in a finished capture file.

    Raises:
        StorageError: The file cannot be read.
    """
    with opened(path) as capture:
        return len(capture.valid_rows())


def read_shot(path: Path, index: int = 0) -> Shot:
    """Read one shot of a finished capture file, checked.

    Args:
        path: A `shot.h5`.
        index: Which of the whole shots, from 0.

    Raises:
        StorageError: Missing, unfinished, damaged or hostile file, wrong schema, no such shot, or a shot that
            contradicts itself.
    """
    with opened(path) as capture:
        rows = capture.valid_rows()
        if not 0 <= index < len(rows):
            raise StorageError(
                f"{path}: no shot {index}",
                allowed=f"0 to {len(rows) - 1}" if len(rows) else "none: it holds no shot",
            )
        return capture.shot(int(rows[index]))


def read_calibration(path: Path) -> dict[str, NDArray[Any]]:
    """Read the static calibration arrays of a finished capture file (`calib/dark`, `masks/bits`, ...).

    Raises:
        StorageError: The file cannot be read.
    """
    with opened(path) as capture:
        arrays = {key: capture.array(key, axes=axes) for key, (_, axes) in CALIBRATION.items()}
    return {key: array for key, array in arrays.items() if array is not None}


@contextmanager
def opened(path: Path, *, unfinished: bool = False) -> Iterator["CaptureFile"]:
    """Open a capture file for reading; turn whatever goes wrong inside into a StorageError.

    Args:
        path: The file.
        unfinished: Accept a `.partial`, too.

    Raises:
        StorageError: Always this, whatever the bytes are.
    """
    if path.is_dir():
        raise StorageError(f"{path}: is a folder", allowed="a shot file", remedy="`gs2ci import` makes a shot file")
    if not path.is_file():
        raise StorageError(f"{path}: no such file", remedy="check the name; `gs2ci import` makes a shot file")
    try:
        if not h5py.is_hdf5(path):
            raise StorageError(
                f"{path}: not an HDF5 file", remedy="turn .npz, .npy or .mat files into a shot with `gs2ci import`"
            )
        check_text_heaps(path)
        with h5py.File(path, "r") as file:
            capture = CaptureFile(path, file)
            capture.check_kind(unfinished=unfinished)
            yield capture
    except StorageError:
        raise
    except Gs2ciError as error:
        raise StorageError(
            f"{path}: {error.problem}",
            allowed=error.allowed,
            remedy="the file was not written by gs2ci, or is damaged",
        ) from error
    except Exception as error:
        # HDF5 reports damage as almost any built-in exception; all of them mean the same to the user.
        detail = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise StorageError(
            f"{path}: truncated, damaged or locked: {detail}",
            remedy=f"copy it again from its source; an interrupted capture still lies in its {PARTIAL} file",
        ) from error


class CaptureFile:
    """An open capture file and the only ways to look into it.

    Args:
        path: For messages.
        file: Opened for reading.
    """

    def __init__(self, path: Path, file: h5py.File) -> None:
        self.path = path
        self.file = file
        self._file_bytes = path.stat().st_size

    def check_kind(self, *, unfinished: bool) -> None:
        """Return if this is a capture file of the known version, and finished or allowed not to be.

        Raises:
            StorageError: It is not.
        """
        schema = self._attribute(self.file, "schema", "/")
        if schema != SCHEMA:
            known = isinstance(schema, str) and schema.startswith("gs2ci.capture/")
            raise StorageError(
                f"{self.path}: schema {schema!r}" if schema is not None else f"{self.path}: not a gs2ci capture file",
                allowed=f"schema {SCHEMA}",
                remedy="read it with the newer gs2ci that wrote it" if known else "import it with `gs2ci import`",
            )
        complete = self.require("complete", axes=0)
        if not unfinished and int(complete) != 1:
            raise StorageError(
                f"{self.path}: key 'complete': the capture was interrupted before its end",
                remedy=f"save its finished rows with `gs2ci recover {self.path}`",
            )

    def valid_rows(self) -> NDArray[np.intp]:
        """Get the indices of the rows whose last write happened, [R].

        Raises:
            StorageError: The file has no flags, or not one for each row.
        """
        valid = self.require("meas_valid", axes=1)
        if len(valid) != self._dataset("meas").shape[0]:
            raise self.wrong("meas_valid", f"{len(valid)} flags for {self._dataset('meas').shape[0]} rows of /meas")
        return np.flatnonzero(valid == 1)

    def shot(self, row: int) -> Shot:
        """Build the checked shot of one row."""
        measurement, saturated = self._measurement(row)
        record = self.record(row)
        cfa = self.text("camera/cfa")
        masks = self.require("masks/calib", axes=3)
        return Shot(
            measurement=measurement,
            masks=unpack(masks, self.number("masks/calib", "full_scale", 1.0)),
            weights=self.require("calib/weights", axes=1).astype(np.float32),
            cfa=cfa,  # type: ignore[arg-type]  # Shot.check refuses any other text
            intrinsics=self.array("camera/intrinsics", axes=2),
            distortion=self.array("camera/distortion", axes=1),
            truth=Truth(self.true_views(row), self.poses("truth/world_to_camera", row)),
            telemetry_world_to_camera=self.poses("telemetry/world_to_camera", row),
            saturated=saturated,
            name=record["name"],
            provenance=record["provenance"],
        ).check()

    def array(self, key: str, *, axes: int, row: int | None = None) -> NDArray[Any] | None:
        """Read a numeric dataset, or one row of it; None where the file has no such key.

        Raises:
            StorageError: Not a dataset of numbers with that many axes, or larger than the file can hold.
        """
        dataset = self._dataset(key, optional=True)
        if dataset is None:
            return None
        if dataset.dtype.kind not in "uif" or dataset.ndim != axes:
            raise self.wrong(key, f"{dataset.dtype} with {dataset.ndim} axes", f"numbers with {axes} axes")
        if row is not None and not 0 <= row < dataset.shape[0]:
            raise self.wrong(key, f"{dataset.shape[0]} rows, row {row} is missing")
        shape = dataset.shape if row is None else dataset.shape[1:]
        self._check_bytes(key, shape, dataset)
        values = np.asarray(dataset[()] if row is None else dataset[row])
        return values.astype(values.dtype.newbyteorder("="), copy=False)

    def require(self, key: str, *, axes: int) -> NDArray[Any]:
        """Read a numeric dataset that every capture file has.

        Raises:
            StorageError: It is missing; or as `array`.
        """
        values = self.array(key, axes=axes)
        if values is None:
            raise self.wrong(key, "missing")
        return values

    def text(self, key: str, row: int | None = None) -> str | None:
        """Read a text, or one row of a list of texts; None where the file has no such key.

        Raises:
            StorageError: Not a text, or longer than any of ours.
        """
        dataset = self._dataset(key, optional=True)
        if dataset is None:
            return None
        if h5py.check_string_dtype(dataset.dtype) is None or dataset.ndim != (0 if row is None else 1):
            raise self.wrong(key, f"{dataset.dtype} with {dataset.ndim} axes", "text")
        if dataset.dtype.itemsize > TEXT_LIMIT_BYTES:
            raise self.wrong(key, f"a text of {dataset.dtype.itemsize} bytes", f"up to {TEXT_LIMIT_BYTES}")
        value = dataset[()] if row is None else dataset[row]
        if not isinstance(value, bytes):
            raise self.wrong(key, "not a text")
        return value.decode("utf-8")

    def number(self, key: str, attribute: str, default: float) -> float:
        """Read a numeric attribute of a dataset; NaN counts as absent where the default is NaN.

        Raises:
            StorageError: The dataset is missing, or its attribute is no finite number.
        """
        value = self._attribute(self._dataset(key), attribute, key)
        value = default if value is None else value
        if not isinstance(value, int | float | np.integer | np.floating):
            raise self.wrong(key, f"attribute {attribute} = {value!r}", "a number")
        if not np.isfinite(value) and not np.isnan(default):
            raise self.wrong(key, f"attribute {attribute} = {value}", "a finite number")
        return float(value)

    def wrong(self, key: str, problem: str, allowed: str = "") -> StorageError:
        """Make the error for a key of this file."""
        return StorageError(
            f"{self.path}: key {key!r}: {problem}",
            allowed=allowed,
            remedy="the file was not written by gs2ci, or is damaged: write it again from its source",
        )

    def _measurement(self, row: int) -> tuple[F32, Bool | None]:
        reading = self.array("meas", axes=self._dataset("meas").ndim, row=row)
        if reading is None or reading.ndim not in (2, 3):
            raise self.wrong("meas", "not a stack of images", "[S, H, W] or [S, H, W, 3]")
        reading = reading[..., None] if reading.ndim == 2 else reading
        offset_dn, scale_dn = self.number("meas", "offset_dn", 0.0), self.number("meas", "scale_dn", 1.0)
        if scale_dn <= 0:
            raise self.wrong("meas", f"attribute scale_dn = {scale_dn}", "a positive number")
        dark, flat = self._per_pixel(reading.shape[:2])
        if dark is not None and flat is not None:
            measurement = ((reading.astype(np.float64) - dark) / (flat * scale_dn)).astype(np.float32)
        elif (offset_dn, scale_dn) == (0.0, 1.0):
            measurement = reading.astype(np.float32)
        else:
            measurement = ((reading.astype(np.float64) - offset_dn) / scale_dn).astype(np.float32)
        clipped: Bool | None = None
        stored_map = self.array("saturated", axes=3, row=row)
        saturation_dn = self.number("meas", "saturation_dn", float("nan"))
        if not np.isnan(saturation_dn):
            clipped = np.any(reading >= saturation_dn, axis=2)
        if stored_map is not None:
            if stored_map.shape != reading.shape[:2]:
                raise self.wrong("saturated", f"shape {list(stored_map.shape)}", str(list(reading.shape[:2])))
            if not (stored_map == NO_MAP).all():
                clipped = (stored_map == 1) if clipped is None else clipped | (stored_map == 1)
        return measurement, clipped

    def _per_pixel(self, size: tuple[int, ...]) -> tuple[F64 | None, F64 | None]:
        """Return each pixel's dark reading and sensitivity, [H, W, 1], where the file says that they are to be used."""
        if self.number("meas", "per_pixel", 0.0) != 1:
            return None, None
        maps = {key: self.array(key, axes=2) for key in ("calib/dark", "calib/flat")}
        if not usable_per_pixel(maps, size):
            raise self.wrong("meas", "attribute per_pixel = 1", "finite calib/dark, and calib/flat above 0")
        dark, flat = (self.require(key, axes=2).astype(np.float64)[..., None] for key in maps)
        return dark, flat

    def numbers(self, key: str) -> Any:
        """Get an h5py dataset for its shape and dtype, or None; its values are read through `array`."""
        return self._dataset(key, optional=True)

    def texts(self, key: str) -> Iterator[str]:
        """Read a list of texts, one by one; none where the file has no such key."""
        dataset = self._dataset(key, optional=True)
        if dataset is not None and dataset.ndim == 1:
            for row in range(min(dataset.shape[0], self._file_bytes)):
                yield self.text(key, row) or ""

    def true_views(self, row: int) -> F32 | None:
        """Read the true views of a row, [N, H, W, C], if it brought them.

        Raises:
            StorageError: The row is missing, or its views are no numbers.
        """
        valid = self.array("truth/views_valid", axes=1)
        if valid is None:
            return None
        if row >= len(valid):
            raise self.wrong("truth/views_valid", f"{len(valid)} flags, row {row} is missing")
        views = self.array("truth/views", axes=5, row=row) if valid[row] == 1 else None
        return None if views is None else unpack(views, self.number("truth/views", "full_scale", 1.0))

    def poses(self, key: str, row: int) -> F64 | None:
        """Read the poses of a row, [N, 4, 4], if it brought them."""
        poses = self.array(key, axes=4, row=row)
        return None if poses is None or np.isnan(poses).all() else poses.astype(np.float64)

    def record(self, row: int) -> dict[str, Any]:
        """Read the name and the provenance of a row.

        Raises:
            StorageError: They are no JSON object.
        """
        record = json.loads(self.text("provenance", row) or "{}")
        if not isinstance(record, dict):
            raise self.wrong("provenance", "not a JSON object")
        name, provenance = record.get("name", "shot"), record.get("provenance", {})
        if not isinstance(name, str) or not isinstance(provenance, dict):
            raise self.wrong("provenance", "not a name and an object")
        return {"name": name, "provenance": provenance}

    def _dataset(self, key: str, *, optional: bool = False) -> Any:
        """Walk to a dataset along hard links only; a link could lead into any file of this machine."""
        node: Any = self.file
        for part in key.split("/"):
            if not isinstance(node, h5py.Group):
                raise self.wrong(key, "its parent is not a group")
            link = node.get(part, getlink=True)
            if link is None:
                if optional:
                    return None
                raise self.wrong(key, "missing")
            if not isinstance(link, h5py.HardLink):
                raise self.wrong(key, "a link to elsewhere", "data inside the file")
            node = node[part]
        if not isinstance(node, h5py.Dataset):
            raise self.wrong(key, "not a dataset")
        if node.is_virtual or node.external:
            raise self.wrong(key, "its data lie in another file", "data inside the file")
        return node

    def _attribute(self, node: Any, name: str, key: str) -> object:
        if name not in node.attrs:
            return None
        attribute = node.attrs.get_id(name)
        if attribute.shape != () or attribute.dtype.itemsize > TEXT_LIMIT_BYTES:
            raise self.wrong(key, f"attribute {name} is no single value")
        value: object = node.attrs[name]
        return value

    def _check_bytes(self, key: str, shape: tuple[int, ...], dataset: Any) -> None:
        # One chunk is decompressed whole, however little of it is asked for.
        wanted = dataset.dtype.itemsize * max(math.prod(shape), math.prod(dataset.chunks or ()))
        allowed = min(LIMIT_BYTES, DEFLATE_LIMIT * self._file_bytes)
        if wanted > allowed:
            raise self.wrong(key, f"claims {wanted} bytes in a file of {self._file_bytes}", f"at most {allowed}")
