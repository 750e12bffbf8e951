"""From `.partial` to the final name: fsync, rename, fsync of the folder, and the manifest beside the file.

Here: paths, the rename that makes a capture count as finished, and the manifest `name.json` with its sha256. Not here:
what is inside the file.
"""

import fcntl
import hashlib
import json
import math
import os
import shutil
from pathlib import Path
from typing import Final

from gs2ci.core.errors import StorageError, room_after
from gs2ci.core.whole_file import check_place, write_whole

MANIFEST_SCHEMA: Final = "gs2ci.manifest/1"
PARTIAL: Final = ".partial"
# Space for HDF5's metadata, the events and the manifest.
SPARE_BYTES: Final = 1_000_000


def partial_of(path: Path) -> Path:
    """Get the name a file has while it is being written."""
    return path.with_name(path.name + PARTIAL)


def manifest_of(path: Path) -> Path:
    """Get the name of the manifest beside a capture file."""
    return path.with_suffix(".json")


def check_target(path: Path, *, replace: bool, remedy: str = "choose another name or move it away") -> None:
    """Check that a capture can be written to a path, before any work.

    Args:
        path: Of the finished file.
        replace: Whether a finished file of that name may be replaced.
        remedy: What the user can do if one exists.

    Raises:
        StorageError: The folder is missing, the name is taken or a folder's, or an unfinished capture of that name
            lies there.
    """
    if not path.parent.is_dir():
        raise StorageError(f"{path}: the folder {path.parent} does not exist", remedy="create it first")
    if path.suffix != ".h5":
        raise StorageError(f"{path}: not a name for a shot file", allowed="a name that ends in .h5")
    if path.is_dir():
        raise StorageError(f"{path}: is a folder", allowed="the name of a file", remedy="choose another name with -o")
    if path.exists() and not replace:
        raise StorageError(f"{path}: already exists", remedy=remedy)
    partial = partial_of(path)
    if being_written(partial):
        raise StorageError(
            f"{partial}: another capture is writing it at this moment",
            remedy="wait until it has ended, or choose another name",
        )
    if partial.exists():
        raise StorageError(
            f"{partial}: an unfinished capture of that name lies there",
            remedy=f"save its rows with `gs2ci recover {partial}`, or delete it",
        )
    check_manifest_place(path)
    check_place(path)


def being_written(partial: Path) -> bool:
    """Return whether another process holds an unfinished capture open for writing, by the lock that it holds on it."""
    try:
        with partial.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # it does not exist, or the file system does not support locks
        return False
    return False


def check_manifest_place(path: Path) -> None:
    """Check that a manifest may be written next to a path: `seal` replaces an earlier one.

    Raises:
        StorageError: A file of that name was not made by gs2ci.
    """
    manifest = manifest_of(path)
    if manifest.exists() and not _is_manifest(manifest):
        raise StorageError(
            f"{manifest}: the manifest belongs there, beside {path.name}, but the file there is not one",
            remedy=f"choose another name for {path.name}, or move {manifest.name} away",
        )


def check_room(path: Path, wanted_bytes: int) -> None:
    """Check that the disk has room for this many bytes and for the metadata.

    This cannot be left to HDF5: if its own write fails, closing the file fails as well, and the library then ends the
    process with a segmentation fault when Python exits (HDF5 2.0.0).

    Raises:
        StorageError: It has too little.
    """
    there = next(folder for folder in path.absolute().parents if folder.is_dir())
    free_bytes, least_bytes = shutil.disk_usage(there).free, wanted_bytes + SPARE_BYTES
    if free_bytes < least_bytes:
        # Rounded apart, or a little too little would read like enough.
        raise StorageError(
            f"{path}: the disk has {math.floor(free_bytes / 1e5) / 10:.1f} MB free",
            allowed=f"{math.ceil(least_bytes / 1e5) / 10:.1f} MB or more",
            remedy="free the disk or choose another folder",
        )


def seal(partial: Path, path: Path) -> None:
    """Make a closed `.partial` the finished file `path`, durably, with its manifest.

    After a power loss at any moment the folder contains the old state or the new one, never an incomplete file under
    the final name.

    Raises:
        StorageError: Writing failed.
    """
    try:
        digest, size = _fsync_and_hash(partial)
        manifest = manifest_of(path)
        manifest.unlink(missing_ok=True)  # an old manifest must never vouch for the new file
        os.replace(partial, path)
        _fsync_folder(path.parent)
        record = {"schema": MANIFEST_SCHEMA, "file": path.name, "bytes": size, "sha256": digest}
        write_whole(manifest, json.dumps(record, indent=2) + "\n", remedy=f"free the disk; the rows are in {path}")
        _fsync_folder(path.parent)
    except OSError as error:
        raise StorageError(
            f"{path}: cannot be finished: {error}", remedy=f"{room_after(error)}; the rows are in {partial} or {path}"
        ) from error


def _is_manifest(path: Path) -> bool:
    try:
        return path.stat().st_size < 10_000 and MANIFEST_SCHEMA in path.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return False


def _hash(path: Path) -> tuple[str, int]:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest(), stream.tell()


def _fsync_and_hash(path: Path) -> tuple[str, int]:
    with path.open("rb+") as stream:
        os.fsync(stream.fileno())
    return _hash(path)


def _fsync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
