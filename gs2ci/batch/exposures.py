"""The exposures in a list of shot files, and the name of each one's run folder.

Here: `FiledShot`, `list_exposures`, `largest_pixels`. Not here: reading an exposure to reconstruct it (`work`).
"""

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.storage import count_shots, read_shot

# Characters outside those that any file system allows in a folder's name; spaces are excluded for easier typing.
_UNFIT: Final = re.compile(r"[^\w.+=-]+")


@dataclass(frozen=True)
class FiledShot:
    """One coded exposure of a file.

    Args:
        name: Name of its run folder, unique in a list.
        file: The shot file, absolute, as every worker finds it.
        index: Which of the file's exposures, from 0.
        stamp: Size in bytes and time of the last change, ns, by which a replaced file is recognised.
    """

    name: str
    file: Path
    index: int
    stamp: tuple[int, int]


def list_exposures(files: Sequence[Path], *, every: bool, index: int = 0) -> list[FiledShot]:
    """List the exposures of files, in their order.

    Args:
        files: Shot files; one that is named twice counts once.
        every: All exposures of each file.
        index: Without `every`, the one of each file.

    Returns:
        At least one. Each is named by its file, with as many parent folders as make the names distinct, and its index.

    Raises:
        InputError: There is no file, a file holds no exposure, or none of that index, or its path is not UTF-8.
        StorageError: A file cannot be read.
    """
    paths = list(dict.fromkeys(Path(os.path.abspath(file)) for file in files))
    if not paths:
        raise InputError("no shot file to reconstruct", remedy="name at least one, as `gs2ci import` writes it")
    found = []
    for path in paths:
        try:
            str(path).encode()
        except UnicodeEncodeError as error:
            raise InputError(
                f"{path} has a path that is not UTF-8, which no list of runs can hold",
                remedy="rename the file or its folder",
            ) from error
    for path, stem in zip(paths, _distinct_names(paths), strict=True):
        count = count_shots(path)
        if not count:
            raise InputError(f"{path} holds no exposure", remedy="leave it out")
        if not every and not 0 <= index < count:
            raise InputError(
                f"{path} has no exposure {index}", allowed=f"0 to {count - 1}", remedy="see --index, --all"
            )
        status = path.stat()
        found += [
            FiledShot(f"{stem}-{one:03d}", path, one, (status.st_size, status.st_mtime_ns))
            for one in (range(count) if every else (index,))
        ]
    return found


def largest_pixels(exposures: Sequence[FiledShot]) -> int:
    """Count the pixels of all views of the largest exposure.

    The exposures of a file share its masks, so that one of each file is read. Damaged ones are skipped: each becomes a
    row with its error when its turn comes. 0 if none can be read.
    """
    sizes: dict[Path, int] = {}
    for one in exposures:
        if one.file not in sizes:
            with suppress(StorageError):
                sizes[one.file] = read_shot(one.file, one.index).masks.size
    return max(sizes.values(), default=0)


def _distinct_names(paths: Sequence[Path]) -> list[str]:
    """Name files with as many of their parent folders as make the names distinct.

    Raises:
        InputError: They cannot be made distinct, because they differ only in characters that a name may not have.
    """
    for depth in range(1, max(len(path.parts) for path in paths) + 1):
        names = [_UNFIT.sub("_", "-".join((*path.parts[-depth:-1], path.stem)).strip("/")) for path in paths]
        # Some file systems do not distinguish "A" from "a".
        if len({name.casefold() for name in names}) == len(names):
            return names
    raise InputError(
        "files whose names differ in spaces or signs alone", remedy="rename them, or take one after another"
    )
