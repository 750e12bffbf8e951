"""Running table cells: in local processes, or on a Dask cluster that exists already.

Here: handing out cells, keeping each as soon as it is done. Not here: the work itself (`works`).
"""

import multiprocessing
import os
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from multiprocessing.connection import wait
from typing import Any, Final

from gs2ci.batch.cluster import connected
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
    """Return the rows of all cells, in their order; only those that are not in the store are worked on.

    Args:
        cells: The work.
        store: What is done already, and where each new row is kept at once.
        processes: Local ones; 1 works in this process.
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
    if scheduler:
        yield from _on_cluster(missing, scheduler)
    elif processes == 1:
        for key, cell in missing.items():
            yield key, run(cell)
    else:
        yield from _in_processes(dict(missing), processes)


def _in_processes(missing: dict[str, Cell], processes: int) -> Iterator[tuple[str, Row | None]]:
    """Work in fresh processes that share this machine's processors evenly.

    A process that dies ends its whole pool. Unfinished cells are tried again, each in a pool of its own, so that only
    the cell that kills its process is lost.
    """
    for key, row in _in_pool(missing, processes):
        del missing[key]
        yield key, row
    for key, cell in missing.items():
        found = dict(_in_pool({key: cell}, 1, processes))
        yield key, found.get(key)


def _in_pool(cells: dict[str, Cell], processes: int, sharing: int = 0) -> Iterator[tuple[str, Row]]:
    """Work until all is done, a process dies, or the caller stops reading rows."""
    threads = max(1, (os.cpu_count() or 1) // (sharing or processes))
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(processes, context, initializer=_settle, initargs=(threads,))
    try:
        futures: dict[Future[Row], str] = {pool.submit(run, cell): key for key, cell in cells.items()}
        for future in as_completed(futures):
            try:
                row = future.result()
            except BrokenProcessPool:
                continue
            yield futures[future], row
    except BaseException:
        # Without this, ending a table early (Ctrl-C, a full disk) would wait for all remaining cells.
        for worker in set(multiprocessing.active_children()) - others:
            worker.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _settle(threads: int) -> None:
    """Prepare a process for its work: no more than its share of the processors, and no longer than it is wanted."""
    import numba  # noqa: PLC0415

    threading.Thread(target=_end_with_parent, daemon=True).start()
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))


def _end_with_parent() -> None:
    """End this process as soon as the one that began it is gone.

    A killed parent cannot stop its pool, and no worker would notice: each holds the others' pipes open.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def _on_cluster(missing: dict[str, Cell], scheduler: str) -> Iterator[tuple[str, Row | None]]:
    """Work on the cluster's workers.

    The scheduler attributes a worker's death to all cells that the worker had. Lost cells are tried again one by one,
    so that only the cell that kills its worker is lost.
    """
    with connected(scheduler) as client:
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
