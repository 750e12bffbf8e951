"""A launch whose arguments are looked at each time it is made, and exchanged only where they differ.

Warp takes 13 microseconds to make a launch of arrays that it knows, and 7 more for each that it has to be told of; a
launch that is kept takes 3 (one core of the machine of docs/gpu.md). In a fit most arguments are those of the iteration
before. Here: launches that are kept, one for each thread, device, kernel and place of the first tensor, since an
iteration calls Adam's for each parameter. Not here: kernels, graphs (`render.warp.recording`).
"""

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import warp as wp
from torch import Tensor

from gs2ci.render.recording import one_at_a_time

_MOST_KEPT: Final = 16
"""Parameters move when Gaussians are added; what is kept for the places of before is then forgotten with the rest."""


class KeptLaunch:
    """Launches one kernel.

    Args:
        kernel: Of Warp's. Arrays that it is given are tensors of one device, the numbers of a vector side by side, or
            Warp's arrays.
        block: Threads of a block, for a kernel that is launched block by block; None: thread by thread.
    """

    def __init__(self, kernel: Any, block: int | None = None) -> None:
        self._kernel, self._block = kernel, block
        self._types = [one.type for one in kernel.adj.args]
        self._own = threading.local()

    def __call__(self, size: int, *arguments: Any) -> None:
        """Launch so many threads, or blocks; the first tensor among the arguments tells the device."""
        if not size:
            return
        first = next(one for one in arguments if isinstance(one, Tensor))
        place = "cpu" if first.is_cpu else f"cuda:{first.get_device()}"
        all_kept: dict[str, _Kept] = self._own.__dict__
        where = f"{place} {first.data_ptr()}"
        if where not in all_kept and len(all_kept) >= _MOST_KEPT:
            all_kept.clear()
        kept = all_kept.setdefault(where, _Kept())
        marks = [_mark(one) for one in arguments]
        with one_at_a_time(place):
            if kept.launch is None:
                kept.launch = self._begin(place, size, arguments)
            else:
                if size != kept.size:
                    kept.launch.set_dim(size if self._block is None else (size, self._block))
                for number, (mark, told) in enumerate(zip(marks, kept.told, strict=True)):
                    if mark != told:
                        kept.launch.set_param_at_index(number, _as_warp(arguments[number], self._types[number]))
            kept.launch.launch()
        kept.size, kept.told = size, marks

    def _begin(self, place: str, size: int, arguments: tuple[Any, ...]) -> Any:
        given = [_as_warp(one, kind) for one, kind in zip(arguments, self._types, strict=True)]
        options: dict[str, Any] = {"device": place, "record_cmd": True}
        if self._block is None:
            return wp.launch(self._kernel, dim=size, inputs=given, **options)
        return wp.launch_tiled(self._kernel, dim=[size], block_dim=self._block, inputs=given, **options)


@dataclass
class _Kept:
    """The launch on one device, by one thread, and what it was told."""

    launch: Any = None
    size: int = 0
    told: Sequence[Any] = ()


def _mark(argument: Any) -> Any:
    """Return what tells an argument from another one."""
    if isinstance(argument, Tensor):
        return argument.data_ptr(), argument.shape, argument.stride()
    return argument.tobytes() if isinstance(argument, np.ndarray) else argument


def _as_warp(argument: Any, kind: Any) -> Any:
    if isinstance(argument, Tensor):  # as `from_torch`, in half the time
        inner = len(getattr(kind.dtype, "_shape_", ()))
        outer, size = argument.ndim - inner, argument.element_size()
        # An image may be three of four numbers of each pixel.
        shape, strides = tuple(argument.shape)[:outer], tuple(size * step for step in argument.stride()[:outer])
        device = "cpu" if argument.is_cpu else f"cuda:{argument.get_device()}"
        return wp.array(
            ptr=argument.data_ptr(), dtype=kind.dtype, shape=shape, strides=strides, device=device, copy=False
        )
    return kind(*argument.ravel().tolist()) if isinstance(argument, np.ndarray) else argument
