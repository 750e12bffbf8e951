"""Running table cells: in this process, by workers on this machine, or on a Dask cluster that exists already.

Here: handing out cells, keeping each as soon as it is done. Not here: the work itself (`works`), starting workers
(`gs2ci.batch.cluster`).
"""

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing
from typing import Any, Final

from gs2ci.batch.cluster import connected, local_workers
from gs2ci.core.errors import InputError
from gs2ci.tables.cells import Cell, run
from gs2ci.tables.store import Row, Store

# How often the scheduler hands a cell out again after an error of the transport.
RETRIES: Final = 2
OnDone = Callable[[int, int], None]
_LOST: Final[Row] = {"error": "the processes that worked on it died"}


def complete(
    cells: Sequence[Cell], store: Store, *, processes: int = 1, scheduler: str = "", on_done: OnDone | None = None
) -> list[Row]:
    """Return the rows of all cells, in their order; only cells that are not in the store are computed.

    Args:
        cells: The work.
        store: What is done already, and where each new row is kept at once.
        processes: On this machine; 1 works in this process, without Dask.
        scheduler: Address of a Dask scheduler ("tcp://host:8786") whose workers have gs2ci and see the same files;
            "" works locally.
        on_done: Called with cells done and cells in all, after each.

    Returns:
        A row per cell; one whose workers died again and again holds an `error`, and is tried again next time.

    Raises:
        InputError: Less than one process, no scheduler answers, or Dask is not installed.
        StorageError: A row cannot be kept, or a cell's file cannot be read.
    """
    if processes < 1:
        raise InputError(f"{processes} processes", allowed="1 or more")
    keys = [cell.key for cell in cells]
    rows = {key: row for key in keys if (row := store.get(key)) is not None}
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
    with connected(scheduler) if scheduler else local_workers(processes) as client:
        yield from _on_cluster(client, missing)


def _on_cluster(client: Any, missing: dict[str, Cell]) -> Iterator[tuple[str, Row | None]]:
    """Work on a cluster's workers.

    The scheduler attributes a worker's death to all cells that the worker had. Lost cells are tried again one by one,
    so that only the cell that kills its worker is lost.
    """
    lost = {}
    for key, row in _submitted(client, missing):
        if row is None:
            lost[key] = missing[key]
        else:
            yield key, row
    for key, cell in lost.items():
        yield from _submitted(client, {key: cell})


def _submitted(client: Any, cells: dict[str, Cell]) -> Iterator[tuple[str, Row | None]]:
    from dask import distributed  # noqa: PLC0415

    futures = {client.submit(run, cell, pure=False, retries=RETRIES): key for key, cell in cells.items()}
    for future in distributed.as_completed(futures):
        try:
            row = future.result()
        except distributed.KilledWorker:
            row = None
        yield futures[future], row
