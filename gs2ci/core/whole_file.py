"""A file of ours appears whole or not at all: whoever reads it sees the old content or the new, never half of it.

Here: `write_whole`, for content that is in memory before it is written: JSON, pages, tables, pictures, scenes, models;
and `check_place`, which a command asks before the work whether its result can be written after it. Not here: captures
and calibration bundles, which grow on the disk and bear a manifest (`gs2ci.core.storage.sealing`; its rules are
stronger: once it returns, the new file itself survives a power loss), and folders of many files
(`gs2ci.evaluate.run_folder`).
"""

import os
import secrets
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Final

from gs2ci.core.errors import StorageError

# A name may have 255 bytes, and the temporary one needs some of its own; a character takes four at most.
_CHARACTERS_OF_NAME: Final = 40


def write_whole(
    path: str | Path,
    content: bytes | str,
    *,
    parents: bool = False,
    remedy: str = "check the folder, its free space and its permissions",
) -> Path:
    r"""Write a file at once; what was there is replaced, and stays as it was if anything goes wrong.

    Args:
        path: Of the file. A symbolic link there is replaced, not followed: where others can write it may point at
            any file of the user's.
        content: Bytes, or a text, written as UTF-8 with the line ends it has ("\n" stays "\n").
        parents: Make the folders above it.
        remedy: What the user can do where it cannot be written.

    Returns:
        The path.

    Raises:
        StorageError: The disk refuses, something other than a file lies there, or UTF-8 cannot hold the text.

    Writers of one path at the same time do not disturb each other: the last to finish is whom readers see. A new file
    has the permissions that the umask leaves, whatever the old one had.
    """
    path = Path(path)
    data = content if isinstance(content, bytes) else _encoded(path, content)
    try:
        # A device or a pipe could be renamed over, but not brought back.
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
    """Return if a file or folder of that name can be made there; to be asked before the work, not after it.

    Args:
        path: Of what is to be made; folders above it may be missing.

    Raises:
        StorageError: The disk refuses: no permission, mounted for reading only, or a file where a folder should be.
    """
    above = Path(path).absolute().parent
    while not above.exists() and above != above.parent:
        above = above.parent
    try:
        # Permissions alone do not tell: a file system may be read-only, and to root everything seems allowed.
        os.rmdir(tempfile.mkdtemp(prefix=".", suffix=".partial", dir=above))
    except OSError as error:
        reason = f"{above}: {error.strerror or error}" if above.is_dir() else f"{above} is not a folder"
        raise StorageError(
            f"{path} cannot be written: {reason}",
            remedy="check the permissions of that folder, or choose another place with -o",
        ) from error


def _encoded(path: Path, text: str) -> bytes:
    try:
        return text.encode("utf-8")
    except UnicodeEncodeError as error:
        # Python takes the bytes of a file name that are no UTF-8 for lone surrogates, and a text may quote the name.
        raise StorageError(
            f"{path} cannot be written: its text holds {text[error.start]!r}, which UTF-8 cannot hold",
            remedy="rename the file or folder whose name is not UTF-8",
        ) from error


def _replace(path: Path, data: bytes) -> None:
    """Write beside the target, where a rename cannot leave the disk, and rename.

    The data reach the disk before the name does: without that, a power loss can leave the new name on no content. The
    folder is not synchronised: a rename that is lost leaves the old file, which is whole as well.
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
    """Say what went wrong without the name of the temporary file, of which the user knows nothing."""
    if isinstance(error, FileExistsError | FileNotFoundError | NotADirectoryError) and not path.parent.is_dir():
        return f"there is no folder {path.parent}"
    return error.strerror or str(error)
