"""One piece of work: what is done, with which arguments, and the row of figures that comes out.

Here: `Cell`, and doing one. Not here: what is done (`works`), who does it (`workers`), keeping it (`store`), which
cells are needed (`tables`). For this package and the commands.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any

from gs2ci.core.errors import Gs2ciError
from gs2ci.tables.store import Row, content_key


@dataclass(frozen=True)
class Cell:
    """One piece of work.

    Args:
        work: "module:function" of what is called; it returns the row.
        arguments: Its arguments: plain values, such as JSON holds.
        files: Paths of the files it reads.
    """

    work: str
    arguments: Mapping[str, Any]
    files: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Get what names the result on disk.

        Raises:
            StorageError: A file cannot be read.
        """
        return content_key(self.work, self.arguments, self.files)


def run(cell: Cell) -> Row:
    """Do the work; an error of ours becomes a row that says so, so that one bad cell does not cost the table."""
    began_s = time.monotonic()
    try:
        row = resolve_name(cell.work)(**cell.arguments)
    except Gs2ciError as error:
        row = {"error": str(error)}
    return {**row, "cell_seconds": time.monotonic() - began_s, "arguments": dict(cell.arguments)}
