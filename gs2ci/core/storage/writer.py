"""Writing capture files: row by row while a rig is running, or finished measurements at once.

Here: `ShotWriter`, whose finished rows survive the death of the process at any moment, and `write_shots`. Not
here: what stands where (`layout.py`), the rename at the end (`sealing.py`).

The order of writes makes a row crash-tolerant: data, then its metadata, then `/meas_valid[i]` = 1, then File.flush().
With HDF5's default library version a killed writer then leaves a file that opens normally. Failed writes are hidden
from the library (`guarded_file`), which would otherwise crash the process.

After `append` has returned, the row survives the death of the process and every later failed write. It survives a
power loss only with `sync`: otherwise it stays in the operating system's memory for some seconds.
"""

import weakref
from collections.abc import Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32, F64, Bool
from gs2ci.core.errors import StorageError, room_after
from gs2ci.core.records import Shot, Truth
from gs2ci.core.storage import layout
from gs2ci.core.storage.guarded_file import GuardedFile
from gs2ci.core.storage.layout import FRAME_COLUMNS, CaptureHeader, FrameRow
from gs2ci.core.storage.reader import CaptureFile
from gs2ci.core.storage.sealing import check_room, check_target, partial_of, seal


class ShotWriter:
    """Write a capture row by row; an unfinished one stays next to the final name as `.partial`.

    Use as a context manager; leaving it without `finish()`, by an error or otherwise, keeps the `.partial` with
    all rows appended so far.

    Args:
        path: Final name, ends in .h5.
        header: Everything known before the first row.
        replace: Whether a finished file of that name may be replaced.
        sync: Wait after each row until the storage device has it, some milliseconds to tenths of a second.

    Raises:
        InputError: The header could belong to no shot.
        StorageError: The file cannot be created there.
    """

    def __init__(self, path: Path, header: CaptureHeader, *, replace: bool = False, sync: bool = False) -> None:
        header.check()
        check_target(path, replace=replace)
        self.path = path
        self.partial = partial_of(path)
        self.rows_written = 0
        self._header = header
        self._sync = sync
        # Readings are not compressed, so their size is known: check the space now, not in the middle.
        check_room(self.partial, header.static_bytes + header.rows * header.row_bytes)
        try:
            # Mode x: two writers of the same name cannot both own the file.
            self._disk = GuardedFile(self.partial)
        except OSError as error:
            raise StorageError(f"{self.partial}: cannot be created: {error}", remedy="check the folder") from error
        self._file: h5py.File | None = None
        try:
            self._file = h5py.File(self._disk, "w")
            # The library must not be left to close it after Python is gone, on which `GuardedFile` stands.
            weakref.finalize(self, _close_quietly, self._file)
            layout.create(self._file, header)
            self._flush(self._file)
        except BaseException as error:
            # Nothing is in it yet that could be lost.
            with suppress(StorageError):
                self.close()
            self.partial.unlink(missing_ok=True)
            if isinstance(error, OSError | RuntimeError):
                raise StorageError(
                    f"{self.partial}: cannot be laid out: {error}",
                    remedy=f"{room_after(error)} or choose another folder",
                ) from error
            raise

    def append(
        self,
        reading: NDArray[Any],
        *,
        frame: FrameRow | None = None,
        telemetry_world_to_camera: F64 | None = None,
        truth: Truth | None = None,
        saturated: Bool | None = None,
        mask_order: Sequence[int] | None = None,
        name: str = "",
        provenance: dict[str, Any] | None = None,
    ) -> int:
        """Store one exposure; when this returns, it survives the death of the process (with `sync`, loss of power).

        Args:
            reading: Counts or values, [H, W] or [H, W, 1] or [H, W, 3], dtype as the header says.
            frame: What sensor and stage reported.
            telemetry_world_to_camera: Poses as the stage reported them, [N, 4, 4].
            truth: What is known beforehand, in simulation.
            saturated: Clipped pixels, [H, W].
            mask_order: Which of the header's masks it was exposed under, N indices in the order of exposure.
            name: For reports; empty: the header's name.
            provenance: Where this row came from.

        Returns:
            Row index.

        Raises:
            InputError: The provenance is not JSON.
            StorageError: The file is full or closed, a part has the wrong shape or dtype or is not finite, the
                header did not announce it, or the disk refused. The row then does not count.
        """
        file, row = self._open_file(), self.rows_written
        if row >= self._header.rows:
            raise StorageError(
                f"{self.partial}: row {row} in a file laid out for {self._header.rows}",
                remedy="announce more rows in the header",
            )
        parts: dict[str, Any] = {"meas": self._reading(reading)}
        parts |= self._optional_parts(telemetry_world_to_camera, truth or Truth(), saturated)
        parts |= self._order(mask_order) | self._frame_columns(frame or FrameRow())
        origin = {"name": name or self._header.name, "provenance": provenance or {}}
        parts["provenance"] = layout.to_json(origin, "provenance")
        check_room(self.partial, sum(np.asarray(value).nbytes for value in parts.values()))
        try:
            for key, value in parts.items():
                dataset = file[key]
                dataset[row] = value
                dataset.flush()
            # HDF5 writes what it has cached in an order of its own: with one flush for both, a process killed in it
            # leaves a flag without its data (seen with small frames under load).
            self._flush(file)
            file["meas_valid"][row] = 1
            self._flush(file)
            if self._sync:
                self._disk.sync()
        except (OSError, RuntimeError, ValueError) as error:
            before = f"; save the rows before it with `gs2ci recover {self.partial}`" if row else ""
            raise StorageError(
                f"{self.partial}: row {row} cannot be written: {error}", remedy=f"{room_after(error)}{before}"
            ) from error
        self.rows_written = row + 1
        return row

    def shot(self, row: int) -> Shot:
        """Read back a row that was appended.

        Raises:
            StorageError: The file is closed, or there is no such row.
        """
        file = self._open_file()
        if not 0 <= row < self.rows_written:
            raise StorageError(
                f"{self.partial}: row {row} of {self.rows_written} written", remedy="ask for one that was appended"
            )
        return CaptureFile(self.partial, file).shot(row)

    def event(self, kind: str, **facts: object) -> None:
        """Log one event (a state change, a fault, a retry) as a JSON line, durably.

        Raises:
            InputError: A fact is not JSON.
            StorageError: The file is closed or the disk refused.
        """
        file = self._open_file()
        line = layout.to_json({"kind": kind, "row": self.rows_written, **facts}, f"event {kind!r}")
        try:
            events = file["events"]
            events.resize((len(events) + 1,))
            events[-1] = line
            self._flush(file)
        except (OSError, RuntimeError, ValueError) as error:
            raise StorageError(
                f"{self.partial}: event {kind!r} cannot be written: {error}", remedy=room_after(error)
            ) from error

    def finish(self) -> Path:
        """Declare the capture complete and give it its final name, with its manifest.

        Returns:
            The final path.

        Raises:
            StorageError: No row was written, the file is closed, or the disk refused.
        """
        file = self._open_file()
        if not self.rows_written:
            raise StorageError(f"{self.partial}: no row was written", remedy="delete it and capture again")
        try:
            self._flush(file)  # everything else is on its way before the mark that says so
            file["complete"][()] = 1
            self._flush(file)
        except (OSError, RuntimeError, ValueError) as error:
            raise StorageError(f"{self.partial}: cannot be finished: {error}", remedy=room_after(error)) from error
        self.close()
        seal(self.partial, self.path)
        return self.path

    def close(self) -> None:
        """Close the file as it is; without `finish()` it stays a `.partial`. May be called twice.

        Raises:
            StorageError: The disk refuses the last bytes.
        """
        if self._file is not None:
            file, self._file = self._file, None
            try:
                # Where this fails, the library goes on holding what is below it.
                file.close()
                with closing(self._disk):
                    self._disk.check()
            except (OSError, RuntimeError) as error:
                raise StorageError(f"{self.partial}: cannot be closed: {error}", remedy=room_after(error)) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        try:
            self.close()
        except StorageError:
            # The first error is the one to report.
            if error is None:
                raise

    def _flush(self, file: h5py.File) -> None:
        """Hand everything to the operating system.

        Raises:
            OSError: It refused this or an earlier write.
        """
        file.flush()
        self._disk.check()

    def _open_file(self) -> h5py.File:
        if self._file is None:
            raise StorageError(f"{self.path}: the writer is closed", remedy="open a new one")
        return self._file

    def _reading(self, reading: NDArray[Any]) -> NDArray[Any]:
        header, shape = self._header, self._header.row_shape
        if reading.shape == (*shape, 1) and header.channels == 1:
            reading = reading[..., 0]
        if reading.dtype != np.dtype(header.reading):
            self._refuse("reading", f"dtype {reading.dtype}", f"{np.dtype(header.reading)}")
        self._fits("reading", reading, shape)
        return reading

    def _fits(self, what: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
        if array.shape != shape:
            self._refuse(what, f"shape {list(array.shape)}", str(list(shape)))
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            self._refuse(what, "values that are NaN or infinite", "finite numbers")

    def _refuse(self, what: str, problem: str, allowed: str) -> None:
        raise StorageError(f"{self.partial}: row {self.rows_written}, {what}: {problem}", allowed=allowed)

    def _optional_parts(self, telemetry: F64 | None, truth: Truth, saturated: Bool | None) -> dict[str, Any]:
        header, views, (height, width) = self._header, self._header.views, self._header.masks.shape[1:]
        channels = 3 if header.cfa else header.channels
        wanted: list[tuple[str, bool, NDArray[Any] | None, tuple[int, ...]]] = [
            ("telemetry/world_to_camera", header.telemetry, telemetry, (views, 4, 4)),
            ("truth/world_to_camera", header.truth_poses, truth.world_to_camera, (views, 4, 4)),
            ("truth/depth", header.truth_depth, truth.depth, (views, height, width)),
            ("truth/views", bool(header.truth_views), truth.views, (views, height, width, channels)),
            ("saturated", header.saturated_map, saturated, (height, width)),
        ]
        parts: dict[str, Any] = {}
        for key, announced, array, shape in wanted:
            if array is None:
                continue
            if not announced:
                self._refuse(key, "given, but not announced", "what the header announces")
            self._fits(key, array, shape)
            parts[key] = array
        if "truth/views" in parts:
            parts["truth/views"] = self._packed_views(parts["truth/views"])
            parts["truth/views_valid"] = 1
        return parts

    def _order(self, order: Sequence[int] | None) -> dict[str, Any]:
        header = self._header
        if order is None and not header.mask_order:
            return {}
        held = len(header.masks)
        known = order is not None and len(order) == header.views and all(0 <= index < held for index in order)
        if not (header.mask_order and known):
            said = f"{header.views} of 0 to {held - 1}" if header.mask_order else "what the header announces"
            self._refuse("masks/order", f"{None if order is None else list(order)}", said)
        return {"masks/order": np.asarray(order, dtype=np.uint16)}

    def _packed_views(self, views: NDArray[Any]) -> NDArray[Any]:
        if self._header.truth_views == "f4":
            return views
        if not layout.fits_bytes(views):
            self._refuse("truth/views", "values between the steps of 1/255", 'truth_views = "f4" in the header')
        return np.rint(views * np.float32(255)).astype(np.uint8)

    def _frame_columns(self, frame: FrameRow) -> dict[str, Any]:
        parts: dict[str, Any] = {f"frames/{column}": getattr(frame, column) for column in FRAME_COLUMNS}
        views, axes = self._header.views, self._header.stage_axes
        for key, position_mm in (("stage_pos", frame.stage_pos_mm), ("stage_target", frame.stage_target_mm)):
            if position_mm is None:
                continue
            if position_mm.shape not in ((axes,), (views, axes)) or not axes:
                self._refuse(key, f"shape {list(position_mm.shape)}", f"[{axes}] or [{views}, {axes}]")
            parts[f"frames/{key}"] = position_mm
        return parts


def _close_quietly(file: h5py.File) -> None:
    if file:
        file.close()


def write_shots(path: Path, shots: Sequence[Shot], *, config: str = "") -> Path:
    """Write finished measurements that share weights, filter array and camera into one capture file.

    A finished file of that name is replaced, at once and whole. Reading a shot back gives the same numbers, bit
    for bit.

    Args:
        path: Final name, ends in .h5.
        shots: One or several measurements; a mask that several of them have is stored once.
        config: Text of the settings they were made with.

    Returns:
        The path.

    Raises:
        InputError: A shot contradicts itself.
        StorageError: The shots do not share what one file holds once, or the file cannot be written. Nothing
            half-written is left behind.
    """
    if not shots:
        raise StorageError(f"{path}: no shots to write", allowed="at least one")
    for shot in shots:
        shot.check()
    _check_alike(path, shots)
    masks, orders = _distinct_masks(shots)
    header = _header_of(shots, masks, config, mask_order=orders[0] is not None)
    writer = ShotWriter(path, header, replace=True)
    try:
        for shot, order in zip(shots, orders, strict=True):
            writer.append(
                shot.measurement,
                telemetry_world_to_camera=shot.telemetry_world_to_camera,
                truth=shot.truth,
                saturated=shot.saturated,
                mask_order=order,
                name=shot.name,
                provenance=shot.provenance,
            )
        return writer.finish()
    except BaseException:
        writer.close()
        writer.partial.unlink(missing_ok=True)
        raise
    finally:
        writer.close()


def _distinct_masks(shots: Sequence[Shot]) -> tuple[F32, list[list[int] | None]]:
    """Return the masks of all shots, each once, [M, H, W], and which of them each has; None: all as they stand."""
    if all(np.array_equal(shot.masks, shots[0].masks) for shot in shots):
        return shots[0].masks, [None] * len(shots)
    found: dict[bytes, int] = {}
    masks: list[F32] = []
    orders: list[list[int] | None] = []
    for shot in shots:
        order = []
        for mask in shot.masks:
            index = found.setdefault(mask.tobytes(), len(masks))
            if index == len(masks):
                masks.append(mask)
            order.append(index)
        orders.append(order)
    return np.stack(masks), orders


def _header_of(shots: Sequence[Shot], masks: F32, config: str, *, mask_order: bool) -> CaptureHeader:
    first = shots[0]
    views = [shot.truth.views for shot in shots if shot.truth.views is not None]
    in_bytes = all(layout.fits_bytes(v) for v in views)
    return CaptureHeader(
        rows=len(shots),
        channels=3 if first.measurement.shape[2] == 3 else 1,
        masks=masks,
        weights=first.weights,
        reading="f4",
        mask_order=mask_order,
        cfa=first.cfa,
        intrinsics=first.intrinsics,
        distortion=first.distortion,
        telemetry=any(shot.telemetry_world_to_camera is not None for shot in shots),
        truth_views=("u1" if in_bytes else "f4") if views else "",
        truth_poses=any(shot.truth.world_to_camera is not None for shot in shots),
        truth_depth=any(shot.truth.depth is not None for shot in shots),
        saturated_map=any(shot.saturated is not None for shot in shots),
        name=first.name,
        config=config,
    )


def _check_alike(path: Path, shots: Sequence[Shot]) -> None:
    first = shots[0]
    for index, shot in enumerate(shots[1:], 1):
        same = {
            "size or number of masks": first.masks.shape == shot.masks.shape,
            "weights": np.array_equal(first.weights, shot.weights),
            "channels": first.measurement.shape == shot.measurement.shape and first.cfa == shot.cfa,
            "intrinsics": _same_arrays(first.intrinsics, shot.intrinsics),
            "distortion": _same_arrays(first.distortion, shot.distortion),
        }
        different = [what for what, equal in same.items() if not equal]
        if different:
            raise StorageError(
                f"{path}: shot {index} differs from shot 0 in {', '.join(different)}",
                allowed="shots of one camera and as many views each",
                remedy="write a file for each",
            )


def _same_arrays(a: F64 | None, b: F64 | None) -> bool:
    if a is None or b is None:
        return a is b
    return np.array_equal(a, b)
