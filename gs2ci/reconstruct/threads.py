"""Independent pieces of work in as many threads as kernels may take.

For libraries that compute without the interpreter's lock (NumPy, OpenCV, pycolmap); and libraries kept on one thread.
Not here: the threads of kernels (Numba's), of fits (`fit/combining/ensemble.py`).
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import cv2
import numba
import torch

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def in_threads(
    work: Callable[[_Item], _Result], items: Iterable[_Item], *, at_most: int | None = None
) -> list[_Result]:
    """Do something with each item; the results are in the items' order, and do not depend on the number of threads.

    Args:
        work: What is done.
        items: What it is done with.
        at_most: How many at once, where each takes much memory.

    Raises:
        Exception: What `work` raises first.
    """
    # torch's own number is one while a measurement is reconstructed.
    threads = numba.get_num_threads() if at_most is None else min(at_most, numba.get_num_threads())
    with ThreadPoolExecutor(max(1, threads)) as pool:
        return list(pool.map(work, items))


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """Run OpenCV's functions on one thread each, where several threads call them."""
    with _one_thread(cv2.getNumThreads, cv2.setNumThreads):
        yield


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Run torch on one thread; the kernels, which take most of the time, run on Numba's threads.

    Torch divides elements among its threads, so that the last bits of sums, products and sigmoids would depend on their
    number. Besides, its thread pool and Numba's disturb each other: on one thread the fit takes a fifth less time.
    """
    with _one_thread(torch.get_num_threads, torch.set_num_threads):
        yield


@contextmanager
def _one_thread(count: Callable[[], int], limit: Callable[[int], object]) -> Iterator[None]:
    """Keep a library on one thread, and give it back as many as it had.

    Args:
        count: Tells how many threads the library takes.
        limit: Sets that number.
    """
    before = count()
    limit(1)
    try:
        yield
    finally:
        limit(before)
