"""Running table cells: in this process, by workers on this machine, or on a Dask cluster that exists already.

Here: which cells are missing, keeping each as soon as it is done. Not here: the work itself (`works`), the workers
(`gs2ci.batch.cluster`).
"""

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from typing import Final

from gs2ci.batch.cluster import completed, workers
from gs2ci.core.errors import InputError
from gs2ci.evaluate.tradeoff.store import Row, Store
from tests.tables.cells import Cell, run

OnDone = Callable[[int, int], None]
_LOST: Final[Row] = {"error": "the processes that worked on it died"}


def complete(
    cells: Sequence[Cell], store: Store, *, processes: int = 1, scheduler: str = "", on_done: OnDone | None = None
) -> list[Row]:
    """Return the rows of all cells, in their order; only cells that the store lacks, or that failed, are computed.

    Args:
        cells: The work.
        store: What is done already, and where each new row is kept at once.
        processes: On this machine; 1 works in this process, without Dask.
        scheduler: Address of a Dask scheduler ("tcp://host:8786") whose workers have gs2ci and see the same files;
            "" works locally.
        on_done: Called with cells done and cells in all, after each.

    Returns:
        A row per cell; one that failed, or whose workers died again and again, holds an `error`, and is tried again
        next time: what failed may lie outside its key, a package that was missing or memory that ran out.

    Raises:
        InputError: Less than one process, no scheduler answers, or Dask is not installed.
        DeviceError: The scheduler went away.
        StorageError: A row cannot be kept, or a cell's file cannot be read.
    """
    if processes < 1:
        raise InputError(f"{processes} processes", allowed="1 or more")
    keys = [cell.key for cell in cells]
    rows = {key: row for key in keys if (row := store.get(key)) is not None and "error" not in row}
    missing = {key: cell for key, cell in zip(keys, cells, strict=True) if key not in rows}
    on_done = on_done or (lambda _done, _total: None)
    on_done(len(rows), len(set(keys)))
    with closing(_worked(missing, processes, scheduler)) as worked:
        for key, row in worked:
            rows[key] = _LOST if row is None else row
            if row is not None:
                store.put(key, row)
            on_done(len(rows), len(set(keys)))
    return [rows[key] for key in keys]


def _worked(missing: dict[str, Cell], processes: int, scheduler: str) -> Generator[tuple[str, Row | None], None, None]:
    if not missing:
        return
    if not scheduler and processes == 1:
        for key, cell in missing.items():
            yield key, run(cell)
        return
    keys = list(missing)
    with workers(processes, scheduler) as client:
        for place, row in completed(client, run, list(missing.values())):
            yield keys[place], None if isinstance(row, Exception) else row
