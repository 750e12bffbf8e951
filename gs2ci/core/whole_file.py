"""Atomic writing of files: a reader sees the old content or the new, never a part of it.

Here: `write_whole`, for content that is in memory before it is written: JSON, pages, tables, pictures, scenes, models;
and, with which a command checks its place before the work, `check_place`, that the result can be written, and
`check_earlier`, that it replaces nothing but an earlier one. Not here: captures and
calibration bundles, which grow on the disk and contain a manifest (`gs2ci.core.storage.sealing`; it guarantees more:
after it returns, the new file survives a power loss), and folders of many files (`gs2ci.evaluate.run_folder`).
"""

import os
import secrets
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Final

from gs2ci.core.errors import StorageError, reason_of

# A name may have 255 bytes, of which the temporary name needs some; a character takes at most four.
_CHARACTERS_OF_NAME: Final = 40
# A mark that tells what a file is stands among its first bytes.
_BYTES_OF_MARK: Final = 4096


def write_whole(
    path: str | Path,
    content: bytes | str,
    *,
    parents: bool = False,
    remedy: str = "check the folder, its free space and its permissions",
) -> Path:
    r"""Write a file at once; an existing file is replaced, or stays unchanged after an error.

    Args:
        path: Of the file. A symbolic link there is replaced, not followed: in a folder where others can write, it may
            point to any file of the user.
        content: Bytes, or a text, written as UTF-8 with its own line ends ("\n" stays "\n").
        parents: Create the folders above it.
        remedy: What the user can do if it cannot be written.

    Returns:
        The path.

    Raises:
        StorageError: Writing fails, the path is not a file, or UTF-8 cannot encode the text.

    Concurrent writers of one path do not disturb each other: readers see the content of the last one to finish. A new
    file has the permissions given by the umask, not those of the old one.
    """
    path = Path(path)
    data = content if isinstance(content, bytes) else _encoded(path, content)
    try:
        # Renaming over a device or a pipe would destroy it.
        if path.exists() and not path.is_file():
            raise StorageError(
                f"{path} cannot be written: something other than a file lies there",
                remedy="move it away, or choose another place",
            )
        if parents:
            path.parent.mkdir(parents=True, exist_ok=True)
        _replace(path, data)
    except OSError as error:
        raise StorageError(f"{path} cannot be written: {_reason(path, error)}", remedy=remedy) from error
    return path


def check_place(path: str | Path) -> None:
    """Check before the work that a file or folder of that name can be created.

    Args:
        path: Of the file or folder; folders above it may be missing.

    Raises:
        StorageError: It cannot: no permission, a read-only disk, a file in place of a folder, or too long a name.
    """
    above = Path(path).absolute()
    missing = [above.name]
    while not os.path.exists(above := above.parent) and above != above.parent:
        missing.append(above.name)
    longest = max(missing, key=lambda name: len(os.fsencode(name)))
    try:
        # Permissions alone are not enough: a file system may be read-only, and for root everything seems allowed. The
        # longest new name is part of it: results are made beside their places, under names as much longer.
        os.rmdir(tempfile.mkdtemp(prefix=f".{longest}.", suffix=".partial", dir=above))
    except OSError as error:
        reason = f"{above}: {reason_of(error)}" if above.is_dir() else f"{above} is not a folder"
        raise StorageError(
            f"{path} cannot be written: {reason}",
            remedy="check the permissions of that folder, or choose another place or a shorter name with -o",
        ) from error


def check_earlier(path: str | Path, mark: bytes, kind: str) -> None:
    """Check before the work that a file to be written replaces none but an earlier one of its kind.

    Args:
        path: Of the file to be written.
        mark: Bytes that every file of this kind has near its beginning.
        kind: What such a file is, as in "a page".

    Raises:
        StorageError: Something else lies there, or it cannot be read.
    """
    path = Path(path)
    try:
        if not path.exists():
            return
        earlier = path.is_file()
        if earlier:
            with path.open("rb") as file:
                earlier = mark in file.read(_BYTES_OF_MARK)
    except OSError as error:
        raise StorageError(
            f"{path} cannot be read: {reason_of(error)}", remedy="choose another place with -o"
        ) from error
    if not earlier:
        raise StorageError(
            f"{path} exists and is not {kind} of gs2ci, so that it is not replaced",
            allowed=f"a new file, or {kind} that gs2ci wrote",
            remedy="choose another place with -o, or move the file away",
        )


def _encoded(path: Path, text: str) -> bytes:
    try:
        return text.encode("utf-8")
    except UnicodeEncodeError as error:
        # Python decodes bytes of a file name that are no UTF-8 as lone surrogates, and a text may quote the name.
        raise StorageError(
            f"{path} cannot be written: its text holds {text[error.start]!r}, which UTF-8 cannot hold",
            remedy="rename the file or folder whose name is not UTF-8",
        ) from error


def _replace(path: Path, data: bytes) -> None:
    """Write a temporary file next to the target, so that both are on one file system, and rename it.

    The data are synchronised before the rename: otherwise a power loss could leave the new name without content. The
    folder is not synchronised: if the rename is lost, the old file remains, which is complete as well.
    """
    partial = path.with_name(f".{path.name[:_CHARACTERS_OF_NAME]}.{secrets.token_hex(8)}.partial")
    # "x" never opens what another has made, nor follows a link. `open` leaves the permissions to the umask; `tempfile`
    # makes private files, and mending that would need the umask, which is read only by setting it for all threads.
    file = partial.open("xb")
    try:
        with file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except BaseException:
        with suppress(OSError):
            partial.unlink()
        raise


def _reason(path: Path, error: OSError) -> str:
    """Describe the error without the name of the temporary file, which the user does not know."""
    if isinstance(error, FileExistsError | FileNotFoundError | NotADirectoryError) and not path.parent.is_dir():
        return f"there is no folder {path.parent}"
    return reason_of(error)
