"""Distributing exposures to workers, and again if a worker died.

Here: `complete`, which yields rows as they come. Not here: the work itself (`work`), starting workers (`cluster`).
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any, Final

from gs2ci.batch.cluster import connected, local_workers
from gs2ci.batch.rows import Row, RowProblem
from gs2ci.batch.work import Task, failed, work
from gs2ci.core.errors import DeviceError, Gs2ciError

# Dask itself gives a task to another worker after a death, by default until it has cost four (its setting
# `distributed.scheduler.allowed-failures`). Further rounds serve shots that did not cause their workers' deaths: if
# half of the attempts fail, one shot in 4096 is lost. A shot whose twelve workers all died is given up.
ROUNDS: Final = 3


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
    crew: AbstractContextManager[Any] = connected(scheduler) if scheduler else local_workers(processes)
    with crew as client:
        yield from _rows_from_cluster(client, tasks)


def _rows_from_cluster(client: Any, tasks: Sequence[Task]) -> Iterator[Row]:
    from dask import distributed  # noqa: PLC0415

    sharing = workers_by_host(client)
    sent: dict[Any, tuple[Task, int]] = {}
    running = distributed.as_completed()

    def send(task: Task, round_: int) -> None:
        # Not pure: otherwise Dask would take equal tasks of two commands for one, and share a stale result.
        future = client.submit(work, replace(task, sharing=sharing), pure=False, key=f"{task.key}-{id(task)}-{round_}")
        sent[future] = task, round_
        running.add(future)

    for task in tasks:
        send(task, 1)
    for future in running:
        task, round_ = sent.pop(future)
        try:
            row = future.result()
        except distributed.KilledWorker as death:
            if round_ < ROUNDS:
                send(task, round_ + 1)
                continue
            row = failed(task, _died(death), lost=True)
        except CancelledError as error:
            raise DeviceError(
                "the Dask scheduler has gone away",
                remedy="start it again; the same command then goes on with what is not done",
            ) from error
        yield row


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
