"""Torch on one thread, and why."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from gs2ci.reconstruct.threads import one_thread


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Run torch on one thread; the kernels, which take most of the time, run on Numba's threads.

    Torch divides elements among its threads, so that the last bits of sums, products and sigmoids would depend on their
    number. Besides, its thread pool and Numba's disturb each other: on one thread the fit takes a fifth less time.
    """
    with one_thread(torch.get_num_threads, torch.set_num_threads):
        yield
