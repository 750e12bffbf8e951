"""Reading capture files that are not trusted: unfinished, damaged, from elsewhere, or malicious.

Here: `read_shot`, `count_shots`, and `CaptureFile`, through which both (and `recover`) read a file. Every fault becomes
one StorageError that names file and key. Not here: safe reading of HDF5 files in general (`gs2ci.core.hdf5`).
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.errors import Gs2ciError, StorageError
from gs2ci.core.hdf5 import NOT_OURS, SuspectFile, check_text_heaps
from gs2ci.core.records import Shot, Truth
from gs2ci.core.storage.layout import NO_MAP, SCHEMA, unpack, usable_per_pixel
from gs2ci.core.storage.padding import PaddedFile, stored_end
from gs2ci.core.storage.sealing import PARTIAL

# If more than this is missing, the file was not cut by one failed write, but is damaged or malicious.
_LONGEST_MISSING_BYTES: Final = 2**40


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
                allowed=_indices(len(rows)),
            )
        return capture.shot(int(rows[index]))


def _indices(shots: int) -> str:
    if shots == 0:
        return "none: it holds no shot"
    return "0: it holds one shot" if shots == 1 else f"0 to {shots - 1}"


@contextmanager
def opened(path: Path, *, unfinished: bool = False) -> Iterator["CaptureFile"]:
    """Open a capture file for reading; turn every error inside into a StorageError.

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
        with _file(path, unfinished=unfinished) as file:
            capture = CaptureFile(path, file)
            capture.check_kind(unfinished=unfinished)
            yield capture
    except StorageError:
        raise
    except Gs2ciError as error:
        raise StorageError(f"{path}: {error.problem}", allowed=error.allowed, remedy=NOT_OURS) from error
    except Exception as error:
        # HDF5 reports damage as almost any built-in exception; all of them mean the same to the user.
        detail = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise StorageError(
            f"{path}: truncated, damaged or locked: {detail}",
            remedy=f"copy it again from its source; an interrupted capture still lies in its {PARTIAL} file",
        ) from error


@contextmanager
def _file(path: Path, *, unfinished: bool) -> Iterator[h5py.File]:
    """Open with the library; an unfinished file whose end is missing as if its end were zeros."""
    end = stored_end(path) if unfinished else None
    if end is None or not path.stat().st_size < end <= path.stat().st_size + _LONGEST_MISSING_BYTES:
        with h5py.File(path, "r") as file:
            yield file
        return
    with PaddedFile(path, end) as padded, h5py.File(padded, "r") as file:
        yield file


class CaptureFile(SuspectFile):
    """An open capture file."""

    def check_kind(self, *, unfinished: bool) -> None:
        """Check that this is a capture file of the known version, and finished unless it may be unfinished.

        Raises:
            StorageError: It is not.
        """
        schema = self.attribute(self.file, "schema", "/")
        if schema != SCHEMA:
            remedies = {
                "gs2ci.capture": "read it with the newer gs2ci that wrote it",
                "gs2ci.calibration": "it is a calibration: give the exposures that `gs2ci capture --calibration` takes",
            }
            raise StorageError(
                f"{self.path}: schema {schema!r}" if schema is not None else f"{self.path}: not a gs2ci capture file",
                allowed=f"schema {SCHEMA}",
                remedy=remedies.get(str(schema).partition("/")[0], "import it with `gs2ci import`"),
            )
        complete = self.require("complete", axes=0)
        if not unfinished and int(complete) != 1:
            raise StorageError(
                f"{self.path}: key 'complete': the capture was interrupted before its end",
                remedy=f"save its finished rows with `gs2ci recover {self.path}`",
            )

    def valid_rows(self) -> NDArray[np.intp]:
        """Get the indices of the complete rows, [R].

        Raises:
            StorageError: The file has no flags, or not one for each row.
        """
        valid = self.require("meas_valid", axes=1)
        if len(valid) != self.dataset("meas").shape[0]:
            raise self.wrong("meas_valid", f"{len(valid)} flags for {self.dataset('meas').shape[0]} rows of /meas")
        return np.flatnonzero(valid == 1)

    def shot(self, row: int) -> Shot:
        """Build the checked shot of one row."""
        measurement, saturated = self._measurement(row)
        record = self.record(row)
        cfa = self.text("camera/cfa")
        return Shot(
            measurement=measurement,
            masks=unpack(self._masks(row), self.number("masks/calib", "full_scale", 1.0)),
            weights=self.require("calib/weights", axes=1).astype(np.float32),
            cfa=cfa,  # type: ignore[arg-type]  # Shot.check refuses any other text
            intrinsics=self.array("camera/intrinsics", axes=2),
            distortion=self.array("camera/distortion", axes=1),
            truth=Truth(self.true_views(row), self.poses("truth/world_to_camera", row), self.true_depth(row)),
            telemetry_world_to_camera=self.poses("telemetry/world_to_camera", row),
            saturated=saturated,
            name=record["name"],
            provenance=record["provenance"],
        ).check()

    def _masks(self, row: int) -> NDArray[Any]:
        """Read the masks of a row as they are stored, in the order of exposure."""
        order = self.order(row)
        if order is None:
            return self.require("masks/calib", axes=3)
        read = {index: self.array("masks/calib", axes=3, row=index) for index in set(order)}
        return np.stack([np.asarray(read[index]) for index in order])

    def order(self, row: int) -> list[int] | None:
        """Read which masks of the file a row was exposed under; None: all, as they stand.

        Raises:
            StorageError: The file holds no such masks.
        """
        held = self.dataset("masks/calib").shape[0]
        order = self.array("masks/order", axes=2, row=row)
        if order is None:
            return None
        if order.dtype.kind != "u" or not order.size or order.max() >= held:
            raise self.wrong("masks/order", f"{order.dtype}, {order.tolist()} in row {row}", f"u2, 0 to {held - 1}")
        return [int(index) for index in order]

    def _measurement(self, row: int) -> tuple[F32, Bool | None]:
        reading = self.array("meas", axes=self.dataset("meas").ndim, row=row)
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
        """Return each pixel's dark reading and sensitivity, [H, W, 1], if the file says that they are to be used."""
        if self.number("meas", "per_pixel", 0.0) != 1:
            return None, None
        maps = {key: self.array(key, axes=2) for key in ("calib/dark", "calib/flat")}
        if not usable_per_pixel(maps, size):
            raise self.wrong("meas", "attribute per_pixel = 1", "finite calib/dark, and calib/flat above 0")
        dark, flat = (self.require(key, axes=2).astype(np.float64)[..., None] for key in maps)
        return dark, flat

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

    def true_depth(self, row: int) -> F32 | None:
        """Read the true depth of a row, [N, H, W], if it brought one.

        Raises:
            StorageError: The row is missing, or its depth is no numbers.
        """
        depth = self.array("truth/depth", axes=4, row=row)
        return None if depth is None or np.isnan(depth).all() else depth.astype(np.float32)

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
