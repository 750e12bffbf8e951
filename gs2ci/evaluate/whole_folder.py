"""A folder of results that appears completely or not at all, and replaces nothing except an earlier one.

Here: the place, the move into it, and what runs and decodes have in common: the report's name, pictures of views. Not
here: their contents (`run_folder`, `decode_folder`). Libraries that only those need are not imported here, because a
decode takes seconds and every import delays it.
"""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from gs2ci.core.arrays import F32
from gs2ci.core.errors import StorageError, reason_of
from gs2ci.core.json_text import parse_json
from gs2ci.core.whole_file import check_place

REPORT_NAME: Final = "report.json"
RUN_SCHEMA: Final = "gs2ci.report/2"
NO_RUN: Final = "give the folder that `gs2ci reconstruct -o` wrote"


def check_destination(folder: Path, *, overwrite: bool = False, schema: str = RUN_SCHEMA) -> None:
    """Refuse a place where no run may be written; to be called before the work, not after it.

    Args:
        folder: The place.
        overwrite: Whether an earlier run may be replaced.
        schema: Schema of the report that an earlier run holds, of any version.

    Raises:
        StorageError: The place holds a file, an earlier run that may not be replaced, or a folder that is no run; or
            nothing can be written there.
    """
    # The new folder is made beside its place and renamed.
    check_place(folder.resolve() if folder.is_symlink() else folder)
    if not folder.exists():
        return
    if not folder.is_dir():
        raise StorageError(f"{folder} is not a folder", remedy="choose another place with -o")
    if folder.is_mount():
        raise StorageError(
            f"{folder} is where a disk or volume is mounted, and nothing can take its place",
            remedy=f"choose a folder in it: -o {folder / 'run'}",
        )
    if not any(folder.iterdir()):
        return
    if not overwrite:
        raise StorageError(
            f"{folder} exists and is not empty",
            allowed="a new or an empty folder",
            remedy="choose another place with -o, or add --overwrite to replace an earlier run",
        )
    if not _holds(folder, schema.partition("/")[0]):
        raise StorageError(
            f"{folder} holds something other than a run, which is not replaced",
            allowed="a folder with a report.json of ours",
            remedy="choose another place with -o",
        )


def _holds(folder: Path, kind: str) -> bool:
    """Return whether a folder holds a report of a kind, of any version."""
    try:
        found = schema_of(folder)
    except StorageError:
        return False
    return isinstance(found, str) and found.partition("/")[0] == kind


@contextmanager
def whole_folder(folder: Path, *, overwrite: bool = False, schema: str = RUN_SCHEMA) -> Iterator[Path]:
    """Provide a hidden sibling folder to fill; rename it into place at the end, remove it after any error.

    Raises:
        StorageError: See `check_destination`; or the disk refuses.
    """
    check_destination(folder, overwrite=overwrite, schema=schema)
    folder = folder.resolve()
    partial = folder.parent / f".{folder.name}.{os.getpid()}.partial"
    try:
        # A folder of this name can only be left over from a killed process that had the same process id.
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        yield partial
        if overwrite:
            swap_in(partial, folder, folder.parent / f".{folder.name}.{os.getpid()}.old")
        else:  # refused by the system if another command has filled the place meanwhile
            partial.rename(folder)
    except OSError as error:
        raise StorageError(
            f"{folder} cannot be written: {reason_of(error)}",
            remedy="check the free space and the permissions, or choose another",
        ) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def swap_in(made: Path, place: Path, aside: Path) -> None:
    """Rename a finished folder to its place; an earlier one there is deleted, or stays after an error or interruption.

    Args:
        made: The folder.
        place: Its place.
        aside: Where the earlier one lies meanwhile, on the same disk.

    Raises:
        OSError: The disk refuses.
    """
    try:
        if place.exists():
            place.rename(aside)
        made.rename(place)
    except BaseException:
        if aside.exists() and not place.exists():
            aside.rename(place)
        raise
    finally:
        if place.exists():
            shutil.rmtree(aside, ignore_errors=True)


def write_pictures(folder: Path, views: F32) -> None:
    """Create a folder of 8-bit pictures of views, [N, H, W, C], clamped to [0, 1].

    Raises:
        StorageError: The disk refuses.
    """
    folder.mkdir()
    for name, view in zip(view_names(len(views)), views, strict=True):
        eight_bit = np.round(255 * np.clip(view, 0, 1)).astype(np.uint8)
        write_png(folder / name, eight_bit[..., ::-1])


def write_png(path: Path, pixels: NDArray[Any]) -> None:
    """Write pixels as OpenCV orders them, [H, W] or [H, W, C] of 8 or 16 bits, as a PNG.

    Raises:
        StorageError: The disk refuses. OpenCV's own writing reports a picture that a full disk has cut as written.
    """
    try:
        path.write_bytes(cv2.imencode(".png", pixels)[1].tobytes())
    except OSError as error:
        raise StorageError(
            f"{path.name} cannot be written: {reason_of(error)}", remedy="check the free space and the permissions"
        ) from error


def view_names(count: int) -> list[str]:
    """Get the file names of the views, in order of exposure."""
    return [f"view_{index:03d}.png" for index in range(count)]


def schema_of(folder: Path) -> Any:
    """Return the name of the schema of a folder's report, whatever else it holds.

    Raises:
        StorageError: There is no report, or it is no JSON.
    """
    path = Path(folder) / REPORT_NAME
    try:
        report = parse_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise StorageError(f"{path} cannot be read: {reason_of(error)}", remedy=NO_RUN) from error
    return report.get("schema") if isinstance(report, dict) else None
