"""Counts what is read back from tensors: on a device each would wait until all that was queued is done.

The host stands in for the device: some tensors are said to lie there, and so does what is computed from them. Not here:
what may be read (the tests that count).
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves

READING = ("numpy", "item", "tolist", "cpu", "__float__", "__int__", "__bool__", "__index__", "__array__", "nonzero")


def said_to_lie_there(tensor: Tensor) -> Tensor:
    """Say that a tensor lies on the device."""
    tensor._there = True  # type: ignore[attr-defined]
    return tensor


class Reads(TorchFunctionMode):
    """Counts the calls that bring numbers from the device to the host, by name; everywhere: from any tensor."""

    def __init__(self, *, everywhere: bool) -> None:
        super().__init__()
        self.calls: Counter[str] = Counter()
        self._everywhere = everywhere

    @property
    def total(self) -> int:
        return sum(self.calls.values())

    def __torch_function__(self, function, types, args=(), kwargs=None):
        name = getattr(function, "__name__", "")
        given = [one for one in tree_leaves((args, kwargs)) if isinstance(one, Tensor)]
        there = self._everywhere or any(hasattr(one, "_there") for one in given)
        result = function(*args, **(kwargs or {}))
        if name in READING:
            self.calls[name] += there
            if name == "cpu":  # of the host's tensors it is the tensor itself
                return result.detach()
        elif there:
            for one in tree_leaves(result):
                if isinstance(one, Tensor):
                    said_to_lie_there(one)
        return result


@contextmanager
def reads(of: Sequence[Tensor] | None = None) -> Iterator[Reads]:
    """Count within a block what is read of some tensors and of what is computed from them; None: of all."""
    for one in of or ():
        said_to_lie_there(one)
    with Reads(everywhere=of is None) as counting:
        yield counting
