"""Places of exports: what may be replaced there, and writing a file or folder completely or not at all.

Not here: what is written (`gs2ci.api.exports`).
"""

import re
import tempfile
from collections.abc import Callable
from pathlib import Path

from gs2ci.api.runs import Run
from gs2ci.core.errors import StorageError, reason_of
from gs2ci.core.whole_file import check_place


def check_free(target: Path, run: Run, files: str | None = None, *, overwrite: bool) -> None:
    """Check that an output can be written, and that nothing is lost by it but an earlier output.

    Args:
        target: The file or folder.
        run: The run that it is made of.
        files: Pattern of the paths inside it, if it is a folder; None for a file.
        overwrite: Whether an earlier output may be replaced.

    Raises:
        StorageError: It exists and may not be replaced, or nothing can be written there.
    """
    check_place(target)
    if not target.resolve().parent.is_dir():
        raise StorageError(
            f"{target} cannot be written: there is no folder {target.parent}", remedy="create it, or choose another"
        )
    if not (target.exists() or target.is_symlink()):
        return
    if not overwrite:
        raise StorageError(f"{target} exists", remedy="choose another name with -o, or add --overwrite to replace it")
    place = target.resolve()
    if run.folder is not None and (home := run.folder.resolve()) in (place, *place.parents):
        raise StorageError(
            f"{target} belongs to the run folder {home}, where an export replaces nothing",
            remedy="choose another place with -o, or move it away first",
        )
    if (target.is_dir() and not target.is_symlink()) != (files is not None):
        kind = "file" if files is None else "folder"
        raise StorageError(
            f"{target} is not a {kind}, and is not replaced by one", remedy="choose another name with -o"
        )
    if files is not None and (other := _other_file(target, files)) is not None:
        raise StorageError(
            f"{target} holds something other than an export of this kind, which is not replaced: {other}",
            remedy="choose another place with -o",
        )


def _other_file(folder: Path, files: str) -> Path | None:
    """Return the first file inside a folder whose path there does not match a pattern; None if there is none."""
    inside = (path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())
    return next((path for path in inside if not re.fullmatch(files, path.relative_to(folder).as_posix())), None)


def write_to(target: Path, write: Callable[[Path], object]) -> Path:
    """Write a file or a folder under a temporary name, and move it to its place, which `check_free` has checked.

    Raises:
        StorageError: Writing fails.
    """
    from gs2ci.evaluate.whole_folder import swap_in

    made = target
    try:
        with tempfile.TemporaryDirectory(dir=target.resolve().parent, prefix=f".{target.name}.") as scratch:
            made = Path(scratch) / target.name
            write(made)
            if target.is_dir() and not target.is_symlink():
                swap_in(made, target, Path(scratch) / "before")
            else:
                made.replace(target)
    except (OSError, StorageError) as error:
        # The user knows the name of the output, and not the temporary one.
        told = error.problem if isinstance(error, StorageError) else f"cannot be written: {reason_of(error)}"
        told = told.replace(str(made), str(target))
        raise StorageError(
            told if told.startswith(str(target)) else f"{target}: {told}",
            remedy="check the free space and the permissions",
        ) from error
    return target
