"""Saving the finished rows of a capture whose writer died.

Here: `recover`, which reads the `.partial` and writes a new file; the damaged one is never touched. On the command
line it is `gs2ci recover NAME.h5.partial`.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from gs2ci.core.errors import StorageError
from gs2ci.core.records import Truth
from gs2ci.core.storage.layout import CALIBRATION, FRAME_COLUMNS, NO_MAP, CaptureHeader, FrameRow, unpack
from gs2ci.core.storage.padding import row_end
from gs2ci.core.storage.reader import CaptureFile, opened
from gs2ci.core.storage.writer import ShotWriter

_IN_ROWS: Final = (
    "meas",
    "masks/order",
    "saturated",
    "telemetry/world_to_camera",
    "truth/world_to_camera",
    "truth/views",
    *(f"frames/{column}" for column in (*FRAME_COLUMNS, "stage_pos", "stage_target")),
)


def recover(partial: Path, out: Path, *, replace: bool = False) -> Path:
    """Copy every whole row of an interrupted capture into a new, finished file.

    Rows keep their order; a row that is marked as complete but cannot be read is skipped. `/events` records such rows
    and the origin of the others.

    Args:
        partial: The `.partial`, or any capture file; opened for reading only.
        out: New file, ends in .h5.
        replace: Whether a finished file of that name may be replaced.

    Returns:
        The new file.

    Raises:
        StorageError: The file cannot be read at all, holds no whole row, or `out` cannot be written.
    """
    if out.resolve() == partial.resolve():
        raise StorageError(f"{out}: would replace the damaged file itself", remedy="choose another name")
    with opened(partial, unfinished=True) as capture:
        rows = [int(row) for row in capture.valid_rows()]
        if not rows:
            raise StorageError(f"{partial}: holds no whole row", remedy="capture again and delete it")
        writer = ShotWriter(out, _header(capture, rows), replace=replace)
        try:
            _copy(capture, writer, rows)
            return writer.finish()
        except BaseException:
            writer.close()
            writer.partial.unlink(missing_ok=True)
            raise


def _copy(capture: CaptureFile, writer: ShotWriter, rows: list[int]) -> None:
    lost = []
    for line in _events(capture):
        writer.event(str(line.pop("kind", "event")), **line)
    for row in rows:
        try:
            _check_there(capture, row)
            parts = _row(capture, row)
        except Exception as error:
            # Damage raises almost any exception; the other rows are still useful.
            lost.append({"row": row, "problem": str(error)})
            continue
        writer.append(**parts)
    writer.event(
        "recovered",
        source=capture.path.name,
        source_run_uid=str(capture.file.attrs.get("run_uid", "")),
        source_rows=rows,
        lost=lost,
    )


def _check_there(capture: CaptureFile, row: int) -> None:
    """Check that a row's data lie completely in the existing part of the file.

    Raises:
        StorageError: Part of them is in the missing end.
    """
    present = capture.path.stat().st_size
    for key in _IN_ROWS:
        dataset = capture.numbers(key)
        if dataset is not None and row_end(dataset, row) > present:
            raise StorageError(f"{capture.path}: row {row}, {key}: lies in the end of the file that is missing")


def _events(capture: CaptureFile) -> Iterator[dict[str, Any]]:
    for line in capture.texts("events"):
        record = json.loads(line)
        if isinstance(record, dict):
            yield record


def _header(capture: CaptureFile, rows: list[int]) -> CaptureHeader:
    meas = capture.numbers("meas")
    stage = capture.numbers("frames/stage_pos")
    views = capture.numbers("truth/views")
    masks = unpack(capture.require("masks/calib", axes=3), capture.number("masks/calib", "full_scale", 1.0))
    saturation_dn = capture.number("meas", "saturation_dn", float("nan"))
    calibration = {key: capture.array(key, axes=axes) for key, (_, axes) in CALIBRATION.items()}
    if meas is None or meas.ndim not in (3, 4):
        raise capture.wrong("meas", "not a stack of images", "[S, H, W] or [S, H, W, 3]")
    return CaptureHeader(
        rows=len(rows),
        channels=3 if meas.ndim == 4 else 1,
        masks=masks,
        weights=capture.require("calib/weights", axes=1).astype(np.float32),
        reading="u2" if meas.dtype.kind == "u" else "f4",
        offset_dn=capture.number("meas", "offset_dn", 0.0),
        scale_dn=capture.number("meas", "scale_dn", 1.0),
        saturation_dn=None if np.isnan(saturation_dn) else saturation_dn,
        per_pixel=capture.number("meas", "per_pixel", 0.0) == 1,
        cfa=capture.text("camera/cfa"),  # type: ignore[arg-type]  # CaptureHeader.check refuses any other text
        intrinsics=capture.array("camera/intrinsics", axes=2),
        distortion=capture.array("camera/distortion", axes=1),
        stage_axes=stage.shape[2] if stage is not None and stage.ndim == 3 else 0,
        telemetry=capture.numbers("telemetry/world_to_camera") is not None,
        truth_views="" if views is None else "u1" if views.dtype == np.uint8 else "f4",
        truth_poses=capture.numbers("truth/world_to_camera") is not None,
        truth_depth=capture.numbers("truth/depth") is not None,
        mask_order=capture.numbers("masks/order") is not None,
        saturated_map=capture.numbers("saturated") is not None,
        calibration={key: array for key, array in calibration.items() if array is not None},
        name=str(capture.file.attrs.get("name", "shot")),
        config=capture.text("config") or "",
    )


def _row(capture: CaptureFile, row: int) -> dict[str, Any]:
    meas = capture.numbers("meas")
    record = capture.record(row)
    saturated = capture.array("saturated", axes=3, row=row)
    frame: dict[str, Any] = {}
    for column in FRAME_COLUMNS:
        value = capture.array(f"frames/{column}", axes=1, row=row)
        frame[column] = 0 if value is None else int(value)
    for key in ("stage_pos", "stage_target"):
        position_mm = capture.array(f"frames/{key}", axes=3, row=row)
        frame[f"{key}_mm"] = None if position_mm is None or np.isnan(position_mm).all() else position_mm
    return {
        "reading": capture.array("meas", axes=meas.ndim, row=row),
        "frame": FrameRow(**frame),
        "telemetry_world_to_camera": capture.poses("telemetry/world_to_camera", row),
        "truth": Truth(capture.true_views(row), capture.poses("truth/world_to_camera", row), capture.true_depth(row)),
        "mask_order": capture.order(row),
        "saturated": None if saturated is None or (saturated == NO_MAP).all() else saturated == 1,
        "name": record["name"],
        "provenance": record["provenance"],
    }
