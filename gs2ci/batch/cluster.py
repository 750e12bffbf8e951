"""Dask: connecting to an existing cluster or starting workers on this machine, and having items of work done by them.

Here: `workers`, `completed`. Not here: the work that is sent (`crew`).
"""

import asyncio
import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from typing import Any, Final, TypeVar

from gs2ci.core.errors import DeviceError, InputError
from gs2ci.evaluate.environment import machine

CONNECT_S: Final = 10
START_S: Final = 300.0
"""Timeout for the start of all workers: seconds on an idle machine, a minute or more on a busy one."""
_LOOK_S: Final = 1.0
_HERE: Final = "127.0.0.1"  # whoever reaches a worker can run programs as its user
_QUIET: Final = 50  # logging.CRITICAL: this module itself reports workers that die
# Dask itself gives a task to another worker after a death, by default until it has cost four (its setting
# `distributed.scheduler.allowed-failures`), and blames all tasks that the worker had. Further rounds serve items that
# did not cause their workers' deaths: if half of the attempts fail, one item in 4096 is lost. An item whose twelve
# workers all died is given up.
ROUNDS: Final = 3
# How often the scheduler hands an item out again after an error of the transport.
RETRIES: Final = 2

Item = TypeVar("Item")
Result = TypeVar("Result")


@contextmanager
def workers(processes: int, scheduler: str) -> Iterator[Any]:
    """Provide a client of an existing cluster, or of `processes` new workers on this machine if no scheduler is named.

    Raises:
        InputError, DeviceError: As `connected` and `local_workers`.
    """
    with connected(scheduler) if scheduler else local_workers(processes) as client:
        yield client


def completed(
    client: Any, work: Callable[[Item], Result], items: Sequence[Item]
) -> Iterator[tuple[int, Result | Exception]]:
    """Have items of work done by a cluster's workers.

    Args:
        client: Of the cluster.
        work: What is done with each; a function of a module, which workers find by its name.
        items: The items; they are pickled.

    Yields:
        Place in `items` and result of each as soon as it has ended, in any order; Dask's KilledWorker as the result if
        all workers that had it died.

    Raises:
        DeviceError: The scheduler went away.
    """
    from dask import distributed  # noqa: PLC0415

    sent: dict[Any, tuple[int, int]] = {}
    running = distributed.as_completed()

    def send(place: int, round_: int) -> None:
        # Not pure: otherwise Dask would take equal items of two commands for one, and share a stale result.
        future = client.submit(work, items[place], pure=False, retries=RETRIES)
        sent[future] = place, round_
        running.add(future)

    for place in range(len(items)):
        send(place, 1)
    for future in running:
        place, round_ = sent.pop(future)
        try:
            result: Result | Exception = future.result()
        except distributed.KilledWorker as death:
            if round_ < ROUNDS:
                send(place, round_ + 1)
                continue
            result = death
        except CancelledError as error:
            raise DeviceError(
                "the Dask scheduler has gone away",
                remedy="start it again; the same command then goes on with what is not done",
            ) from error
        yield place, result


@contextmanager
def connected(scheduler: str) -> Iterator[Any]:
    """Provide a client of a Dask scheduler, closed at the end.

    Args:
        scheduler: Its address, such as "tcp://host:8786".

    Raises:
        InputError: No scheduler answers there, or dask.distributed is not installed.
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
    """Start worker processes on this machine, one thread each; provide a client of them; end both.

    A worker that dies is replaced, also one that dies while it starts: Dask's own nannies give up in that case, or time
    out on a busy machine. Nothing listens beyond this machine, and there only for who has the key of this command,
    which its processes keep in memory: other users of a shared computer could run programs as this one otherwise.

    Raises:
        InputError: dask.distributed is not installed.
        DeviceError: No worker has started after minutes.
    """
    distributed = _distributed(f"--processes {processes}")
    import dask  # noqa: PLC0415

    # Workers get one task at a time, so that a death is attributed to the task that ran.
    settings = {"distributed.scheduler.worker-saturation": 1.0, "distributed.admin.log-level": "critical"}
    threads = max(1, machine().usable_cores // processes)
    key = _own_key(distributed)
    with (
        _hushed(),
        dask.config.set(settings),
        distributed.LocalCluster(
            n_workers=0,
            threads_per_worker=1,
            host=_HERE,
            protocol="tls://",
            security=key,
            dashboard_address=f"{_HERE}:0",
            silence_logs=_QUIET,
        ) as cluster,
        distributed.Client(cluster) as client,
        _kept_running(cluster.scheduler_address, key, processes, threads),
    ):
        try:
            client.wait_for_workers(processes, timeout=START_S)
        except TimeoutError as error:
            raise DeviceError(
                f"of {processes} worker processes not all have started after {START_S:.0f} s",
                allowed="processes that can start Python and connect to each other on this machine",
                remedy="take fewer --processes, or 1, which needs no others",
            ) from error
        yield client


@contextmanager
def _hushed() -> Iterator[None]:
    """Keep Dask's logs quiet, also while a cluster ends: by then it has undone its own `silence_logs`."""
    logger = logging.getLogger("distributed")
    level = logger.level
    logger.setLevel(_QUIET)
    try:
        yield
    finally:
        logger.setLevel(level)


@contextmanager
def _kept_running(scheduler: str, key: Any, processes: int, threads: int) -> Iterator[None]:
    """Keep `processes` workers of a scheduler running, each with `threads` kernel threads, and stop them at the end."""
    import dask  # noqa: PLC0415

    spawning = multiprocessing.get_context("spawn")
    over = threading.Event()

    def start() -> BaseProcess:
        # Daemons, so that none outlives this process. They are started as by Dask's nannies: one thread each.
        process = spawning.Process(target=_serve, args=(scheduler, key), daemon=True)
        begun_with = dict(dask.config.get("distributed.nanny.pre-spawn-environ")) | {"NUMBA_NUM_THREADS": threads}
        before = {name: os.environ[name] for name in begun_with if name in os.environ}
        os.environ.update({name: str(value) for name, value in begun_with.items()})
        try:
            process.start()
        finally:
            for name in begun_with:
                del os.environ[name]
            os.environ.update(before)
        return process

    crew = [start() for _ in range(processes)]

    def replace_the_dead() -> None:
        while not over.wait(_LOOK_S):
            crew[:] = [process if process.is_alive() else start() for process in crew]

    keeper = threading.Thread(target=replace_the_dead, name="workers", daemon=True)
    keeper.start()
    try:
        yield
    finally:
        over.set()
        keeper.join()
        # They are idle now and are killed: on a regular exit, libraries that they have loaded would print messages.
        for process in crew:
            process.kill()
        for process in crew:
            process.join()


def _own_key(distributed: Any) -> Any:
    """Make a key and a certificate for this command alone; both sides of every connection have to show it.

    Raises:
        InputError: cryptography is not installed.
    """
    try:
        return distributed.Security.temporary()
    except ImportError as error:
        raise InputError(
            "processes of their own need the package cryptography, which is not installed",
            remedy="pip install 'gs2ci[cluster]', or take --processes 1",
        ) from error


def _serve(scheduler: str, key: Any) -> None:
    """Work for a scheduler until it goes away: the body of a worker process."""
    from dask import distributed  # noqa: PLC0415

    # The parent process handles Ctrl-C.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    logging.getLogger("distributed").setLevel(_QUIET)

    async def work() -> None:
        # The system handles a lack of memory; Dask would pause or kill workers by its own estimates.
        here = {"host": _HERE, "dashboard_address": f"{_HERE}:0"}
        async with distributed.Worker(
            scheduler, security=key, nthreads=1, memory_limit=0, dashboard=False, **here
        ) as worker:
            await worker.finished()

    asyncio.run(work())


def _end_with_parent() -> None:
    """End this process as soon as the one that began it is gone, whatever it works on: that one cannot tell it to."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def _distributed(wanted_for: str) -> Any:
    try:
        from dask import distributed  # noqa: PLC0415
    except ImportError as error:
        raise InputError(f"{wanted_for} needs dask.distributed", remedy="pip install 'gs2ci[cluster]'") from error
    return distributed
