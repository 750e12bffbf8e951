"""What a second thread of OpenBLAS costs on small matrices, on idle cores and beside another process.

    python -m tests.benchmarks small_matrices

Each row is timed in a process of its own, with one thread of OpenBLAS or with its default of one for each core, on idle
cores or while another process keeps each of them busy. Times are means, in milliseconds, of as many repetitions as take
a fifth of a second.
"""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from timeit import Timer

import numpy as np
from scipy.linalg import lu_factor, lu_solve
from scipy.spatial import Delaunay

_BUSY = "while True: sum(range(100000))"
_VARIABLE = "OPENBLAS_NUM_THREADS"


def run() -> None:
    names = operations().keys()
    print("| cores | threads | " + " | ".join(names) + " |")
    print("|---|---|" + "---|" * len(names))
    for cores, others in (("idle", 0), ("busy", len(os.sched_getaffinity(0)))):
        for threads in ("1", None):
            with _kept_busy(others):
                taken = _timed_with(threads)
            print(f"| {cores} | {threads or 'default'} | {taken} |", flush=True)


def operations() -> dict[str, Callable[[], object]]:
    """Name what is timed; the last is what ENI asks of the samples of one mask."""
    random = np.random.default_rng(0)
    six, hundred = (_positive(random, size) for size in (6, 100))
    factors = lu_factor(six)
    samples = np.argwhere(random.random((96, 128)) < 0.25).astype(np.float64)
    return {
        "solve 100 x 100": lambda: np.linalg.solve(hundred, hundred[0]),
        "eigh 100 x 100": lambda: np.linalg.eigh(hundred),
        "lu_solve 6 x 6": lambda: lu_solve(factors, six[:, :2]),
        "transform of 3,000 samples' triangles": lambda: Delaunay(samples).transform,
    }


def _positive(random: np.random.Generator, size: int) -> np.ndarray:
    values = random.random((size, size))
    return values @ values.T + np.eye(size)


def _timed_with(threads: str | None) -> str:
    environment = {name: value for name, value in os.environ.items() if name != _VARIABLE}
    environment |= {} if threads is None else {_VARIABLE: threads}
    command = [sys.executable, "-c", "from tests.benchmarks.small_matrices import time_all; time_all()"]
    return subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout.strip()


def time_all() -> None:
    """Print the mean milliseconds of each operation, with this process's threads."""
    print(" | ".join(f"{1e3 * _mean_s(work):.2g}" for work in operations().values()))


def _mean_s(work: Callable[[], object]) -> float:
    repetitions, seconds = Timer(work).autorange()
    return seconds / repetitions


@contextmanager
def _kept_busy(processes: int) -> Iterator[None]:
    others = [subprocess.Popen([sys.executable, "-c", _BUSY]) for _ in range(processes)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()
