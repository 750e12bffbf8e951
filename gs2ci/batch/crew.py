"""Distributing exposures to workers.

Here: `complete`, which yields rows as they come. Not here: the work itself (`work`), the workers (`cluster`).
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from gs2ci.batch.cluster import completed, workers
from gs2ci.batch.rows import Row, RowProblem
from gs2ci.batch.work import Task, failed, work
from gs2ci.core.errors import Gs2ciError


class WorkersDiedError(Gs2ciError):
    """All workers that processed an exposure died."""


def complete(tasks: Sequence[Task], *, processes: int = 1, scheduler: str = "") -> Iterator[Row]:
    """Yield the row of each task as soon as it has ended, in any order, each once.

    Args:
        tasks: The tasks.
        processes: Number of processes on this machine; 1 works in this process, without Dask.
        scheduler: Address of a Dask scheduler that is used instead.

    Raises:
        InputError: No scheduler answers, or dask.distributed is not installed.
        DeviceError: The scheduler went away.
    """
    if not tasks:
        return
    if not scheduler and processes == 1:
        yield from map(work, tasks)
        return
    with workers(processes, scheduler) as client:
        sharing = workers_by_host(client)
        sent = [replace(task, sharing=sharing) for task in tasks]
        for place, row in completed(client, work, sent):
            yield failed(tasks[place], _died(row), lost=True) if isinstance(row, Exception) else row


def workers_by_host(client: Any) -> dict[str, int]:
    """Count a cluster's workers on each machine, by host name."""
    found = client.run(_hostname, on_error="ignore")
    return dict(Counter(found.values()))


def _hostname() -> str:
    import socket  # noqa: PLC0415

    return socket.gethostname()


def _died(death: Exception) -> RowProblem:
    last = getattr(getattr(death, "last_worker", None), "address", "")
    return RowProblem.of(
        WorkersDiedError(
            f"every worker that had it died{f', the last at {last}' if last else ''}",
            remedy="most often memory ran out: fewer workers on a machine, or a smaller picture",
        )
    )
