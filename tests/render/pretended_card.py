"""A card that is pretended: torch's tensors of "cpu:0" count as lying there, and are kept apart from the host's.

As on a card, an operation on tensors of both places is an error, unless the host's has no dimension, and so are numbers
that are taken from there without a copy. Warp's arrays and kernels take the host's memory for the card's. Not here:
what a card computes otherwise (order of sums), and what it computes while Python goes on.
"""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread
from unittest.mock import patch

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves

from gs2ci.render import places
from gs2ci.render.warp.backend import WarpBackend

CARD = torch.device("cpu", 0)
HOST = torch.device("cpu")
# Between both places: copies, and what takes indices or a row from the host.
BETWEEN = ("to", "copy_", "cpu", "__getitem__", "__setitem__", "__get__", "__set__", "from_numpy", "backward")
WITHOUT_COPY = ("numpy", "__array__")


class Apart(TorchFunctionMode):
    """Keeps both places apart within a block, in each thread that enters it.

    Attributes:
        names: Operations on the card, and how many there were of each.
        of_floats: Those on numbers that are rounded, so that their order counts.
    """

    def __init__(self) -> None:
        super().__init__()
        self.names: Counter[str] = Counter()
        self.of_floats: Counter[str] = Counter()

    def __torch_function__(self, function, types, args=(), kwargs=None):
        kwargs, name = kwargs or {}, getattr(function, "__name__", "")
        given = [one for one in tree_leaves((args, kwargs)) if isinstance(one, Tensor)]
        there = any(lies_there(one) for one in given)
        self.names[name] += there
        self.of_floats[name] += there and any(one.is_floating_point() for one in given)
        if there and name in WITHOUT_COPY:
            raise TypeError(f"{name} of a tensor of the card")
        strangers = [one for one in given if not lies_there(one) and one.ndim]
        if there and strangers and name not in BETWEEN:
            raise RuntimeError(f"{name} of tensors of both places: the host's has {list(strangers[0].shape)}")
        if name == "__getitem__" and not lies_there(args[0]) and there:
            raise RuntimeError("a tensor of the host by indices of the card")
        result = function(*args, **kwargs)
        if getattr(function, "__self__", None) is Tensor.device:
            return CARD if there else HOST
        named = [one for one in tree_leaves((args, kwargs)) if isinstance(one, (str, torch.device))]
        asked = [torch.device(one) for one in named if str(one).startswith("cpu")]
        goes_there = asked[0].index == 0 if asked else there
        if name == "cpu" or (asked and goes_there != there):
            result = result.clone()  # of the same place it would be the tensor itself
            result.__dict__.pop("_there", None)
        if goes_there and name != "cpu":
            for one in tree_leaves(result):
                if isinstance(one, Tensor):
                    one._there = True
        return result


def lies_there(tensor: Tensor) -> bool:
    """Tell whether a tensor lies on the card."""
    return "_there" in getattr(tensor, "__dict__", {})


@contextmanager
def pretended_card() -> Iterator[Apart]:
    """Let Warp's renderers lie on the card, and work with arrays of the host that can be done there, within a block."""
    plain = WarpBackend.__init__

    def on_card(self, *given, **named):
        plain(self, *given, **named)
        self.device = CARD

    begun = Thread.run

    def begin(thread):
        # Fits go on in threads of their own, and may come back from there.
        with apart:
            begun(thread)

    places.count_host_as_device(yes=True)
    try:
        with (
            patch.object(WarpBackend, "__init__", on_card),
            patch.object(Thread, "run", begin),
            Apart() as apart,
        ):
            yield apart
    finally:
        places.count_host_as_device(yes=False)
