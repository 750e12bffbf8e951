"""Which exposures a list of shot files holds, and the name of each one's run folder.

Here: `FiledShot`, `list_exposures`. Files are opened for their counts alone. Not here: reading an exposure (`work`).
"""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from gs2ci.core.errors import InputError
from gs2ci.core.storage import count_shots

# What a folder's name may hold everywhere, spaces left out so that it can be typed.
_UNFIT: Final = re.compile(r"[^\w.+=-]+")


@dataclass(frozen=True)
class FiledShot:
    """One coded exposure of a file.

    Args:
        name: Of its run folder; no two of a list have the same.
        file: The shot file, absolute, as every worker finds it.
        index: Which of the file's exposures, from 0.
        stamp: Size in bytes and time of the last change, ns: by which a file that was replaced is known.
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
        At least one. Each is named by its file, as far up as tells the files apart, and by its index.

    Raises:
        InputError: There is no file, a file holds no exposure, or none of that index.
        StorageError: A file cannot be read.
    """
    paths = list(dict.fromkeys(Path(os.path.abspath(file)) for file in files))
    if not paths:
        raise InputError("no shot file to reconstruct", remedy="name at least one, as `gs2ci import` writes it")
    found = []
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


def _distinct_names(paths: Sequence[Path]) -> list[str]:
    """Name files by as many of their folders as it takes to tell them apart.

    Raises:
        InputError: No number of folders does, because their names differ in nothing that a folder's name may hold.
    """
    for depth in range(1, max(len(path.parts) for path in paths) + 1):
        names = [_UNFIT.sub("_", "-".join((*path.parts[-depth:-1], path.stem)).strip("/")) for path in paths]
        # Some file systems do not tell "A" from "a".
        if len({name.casefold() for name in names}) == len(names):
            return names
    raise InputError(
        "files whose names differ in spaces or signs alone", remedy="rename them, or take one after another"
    )
