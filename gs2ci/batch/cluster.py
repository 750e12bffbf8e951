"""Dask: connecting to a cluster that exists, or starting workers on this machine.

Here: `connected`, `local_workers`. Not here: what is sent to them (`crew`; `gs2ci.tables.workers`).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from gs2ci.core.errors import InputError

CONNECT_S: Final = 10
_QUIET: Final = 50  # logging.CRITICAL: a worker that dies is told of by us


@contextmanager
def connected(scheduler: str) -> Iterator[Any]:
    """Give a client of a Dask scheduler, closed in the end.

    Args:
        scheduler: Its address, such as "tcp://host:8786".

    Raises:
        InputError: None answers there, or dask.distributed is not installed.
    """
    distributed = _distributed(f"--scheduler {scheduler}")
    try:
        client = distributed.Client(scheduler, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no Dask scheduler answers at {scheduler}: {error}",
            allowed="an address as `dask scheduler` prints it, such as tcp://host:8786",
            remedy="start one, or leave --scheduler out",
        ) from error
    with client:
        yield client


@contextmanager
def local_workers(processes: int) -> Iterator[Any]:
    """Start worker processes on this machine, one thread each; give a client of them; end both.

    A worker that dies is replaced. Nothing listens beyond this machine.

    Raises:
        InputError: dask.distributed is not installed.
    """
    distributed = _distributed(f"--processes {processes}")
    import dask  # noqa: PLC0415

    settings = {
        # Workers are given one task at a time: a death is then blamed on the one that ran.
        "distributed.scheduler.worker-saturation": 1.0,
        "distributed.admin.log-level": "critical",
        # The system decides what happens when memory runs out; Dask would pause workers or kill them at guesses.
        "distributed.worker.memory.target": False,
        "distributed.worker.memory.spill": False,
        "distributed.worker.memory.pause": False,
        "distributed.worker.memory.terminate": False,
    }
    with (
        dask.config.set(settings),
        distributed.LocalCluster(
            n_workers=processes,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address=None,
            memory_limit=0,
            silence_logs=_QUIET,
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


def _distributed(wanted_for: str) -> Any:
    try:
        from dask import distributed  # noqa: PLC0415
    except ImportError as error:
        raise InputError(f"{wanted_for} needs dask.distributed", remedy="pip install 'gs2ci[cluster]'") from error
    return distributed
