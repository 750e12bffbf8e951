"""What a second thread of OpenBLAS costs on small matrices, on idle cores and beside another process.

    python -m tests.benchmarks small_matrices

Each operation is timed in processes of their own, with one thread of OpenBLAS and with its default of one per core;
first on an idle machine, then while one other process for each core counts. Times are the median of
repetitions, in milliseconds; an operation is not repeated further once it has taken `_SECONDS`.
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from scipy.linalg import lu_factor, lu_solve
from scipy.spatial import Delaunay

_REPETITIONS = 20
_SECONDS = 10.0
_BUSY = "while True: sum(range(100000))"
_VARIABLE = "OPENBLAS_NUM_THREADS"


def run() -> None:
    print("| cores | threads | " + " | ".join(operations()) + " |")
    print("|---|---|" + "---|" * len(operations()))
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
    """Print the median milliseconds of each operation, with this process's threads."""
    print(" | ".join(f"{1e3 * _median_s(work):.3g}" for work in operations().values()))


def _median_s(work: Callable[[], object]) -> float:
    taken: list[float] = []
    while len(taken) < _REPETITIONS and sum(taken) < _SECONDS:
        begun = time.perf_counter()
        work()
        taken.append(time.perf_counter() - begun)
    return float(np.median(taken))


@contextmanager
def _kept_busy(processes: int) -> Iterator[None]:
    others = [subprocess.Popen([sys.executable, "-c", _BUSY]) for _ in range(processes)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()
