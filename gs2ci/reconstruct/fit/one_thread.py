"""Torch on one thread, and why."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Keep torch on one thread; the kernels that take the time have Numba's.

    Torch deals its elements out by the number of threads, and with that the last bits of sums, products and sigmoids
    change. Besides, its pool and Numba's disturb each other: on one thread the fit takes a fifth less time.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
