"""Counts what is read back from tensors: on a device each would wait until all that was queued is done.

The host stands in for the device. Not here: what may be read (the tests that count).
"""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from torch.overrides import TorchFunctionMode

READING = ("numpy", "item", "tolist", "cpu", "__float__", "__int__", "__bool__", "__index__", "__array__", "nonzero")


class Reads(TorchFunctionMode):
    """Counts the calls that bring numbers from tensors to the host, by name."""

    def __init__(self) -> None:
        super().__init__()
        self.calls: Counter[str] = Counter()

    @property
    def total(self) -> int:
        return sum(self.calls.values())

    def __torch_function__(self, function, types, args=(), kwargs=None):
        name = getattr(function, "__name__", "")
        if name in READING:
            self.calls[name] += 1
        return function(*args, **(kwargs or {}))


@contextmanager
def reads() -> Iterator[Reads]:
    """Count within a block."""
    with Reads() as counting:
        yield counting
