"""One cell of a table: the function called, its arguments, and the row of figures that it returns.

Here: `Cell`, and doing one. Not here: what is done (`works`), who does it (`workers`), keeping it (`store`), which
cells are needed (`catalogue`).
"""

import hashlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

from gs2ci.core.errors import Gs2ciError, InputError, StorageError, reason_of
from gs2ci.evaluate.tradeoff.store import Row, content_key

# The sources of the tables themselves: any change in them may change a figure, as one in the product's may.
_SOURCES: Final = tuple(str(path) for path in sorted(Path(__file__).parent.glob("*.py")) if path.name[:5] != "test_")


@dataclass(frozen=True)
class Cell:
    """One piece of work.

    Args:
        work: What is called; it returns the row. A function of a module, which other processes and machines find by
            its name, and which the result on disk is named by.
        arguments: Its arguments: plain values, such as JSON holds.
        files: Paths of the files it reads.
    """

    work: Callable[..., Row]
    arguments: Mapping[str, Any]
    files: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse a function or arguments that another process could not load.

        Raises:
            InputError: The function is no module's own: a lambda, a method, or made within another.
        """
        if not self.work.__qualname__.isidentifier():
            raise InputError(f"{self.name} as the work of a cell", allowed="a function of a module")

    @property
    def name(self) -> str:
        """Get the name of its work."""
        return f"{self.work.__module__}:{self.work.__qualname__}"

    @property
    def key(self) -> str:
        """Get the hash that names the result on disk.

        Raises:
            StorageError: A file cannot be read.
        """
        digests = [_digest(name) for name in (*self.files, *_SOURCES)]
        return content_key(self.name, {"arguments": self.arguments, "files": digests})


@cache
def _digest(name: str) -> str:
    try:
        with Path(name).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise StorageError(
            f"{name} cannot be read: {reason_of(error)}", remedy="name the folder with --data"
        ) from error


def run(cell: Cell) -> Row:
    """Do the work; an error of ours becomes a row that states it, so that one failed cell does not end the table."""
    began_s = time.monotonic()
    try:
        row = cell.work(**cell.arguments)
    except Gs2ciError as error:
        row = {"error": str(error)}
    return {**row, "cell_seconds": time.monotonic() - began_s, "arguments": dict(cell.arguments)}
