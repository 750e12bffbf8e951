"""Tables whose rows are whole reconstructions, each in a process of its own: one task a core, or one after the other.

Rows come back in their order, or as they end. Side by side for figures of accuracy; seconds taken so say little.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any, Final, TypeVar

Task = TypeVar("Task")
Row = TypeVar("Row")

_THREADS: Final = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
ONE_THREAD: Final = {**dict.fromkeys(_THREADS, "1"), "OMP_WAIT_POLICY": "PASSIVE"}
"""Environment of a process with one thread, read when it starts: libraries that count cores would otherwise take them
all, in every process."""


def side_by_side(work: Callable[[Task], Row], tasks: Iterable[Task], jobs: int | None = None) -> Iterator[Row]:
    """Yield what `work` returns for each task, in the order of the tasks.

    Args:
        work: A function of a module's top level, so that another process can import it.
        tasks: What is handed over must be picklable.
        jobs: Processes; by default one for each core that this process may use.
    """
    with _pool(jobs) as pool:
        yield from pool.map(work, tasks)


def as_they_end(work: Callable[[Task], Row], tasks: Iterable[Task], jobs: int | None = None) -> Iterator[Row]:
    """Yield what `work` returns for each task as soon as it does: a long task withholds no other's row."""
    with _pool(jobs) as pool:
        for done in as_completed([pool.submit(work, task) for task in tasks]):
            yield done.result()


def _pool(jobs: int | None) -> ProcessPoolExecutor:
    os.environ.update(ONE_THREAD)
    return ProcessPoolExecutor(jobs or len(os.sched_getaffinity(0)), mp_context=get_context("spawn"))


def answer_of(module: str, arguments: list[str], environment: Mapping[str, str]) -> dict[str, Any]:
    """Run a module's `one()` in a process of its own, and return the JSON of the last line that it prints."""
    code = f"from {module} import one; one()"
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], env=environment, check=True, capture_output=True, text=True
    )
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found
