"""Launches on arrays that stay where they are: made one by one, or all at once by a graph that was captured from them.

Python takes some 20 microseconds to make a launch, longer than most kernels take of a card. What is launched in each
iteration on the same arrays is therefore called as it is written once, captured when it is due again, and replayed from
then on; the one function is all there is, so that what is replayed is what was called. If the driver refuses, the
function is called on, and the reason is kept (`refusal`). The host's graphs (Warp replays launches there too) serve
tests and counts alone: a capture on the host would take in what other threads launch meanwhile. Never run on a GPU.

Here: this, the stream for it, and what all kernels in Warp share. Not here: what is launched (`warp/arrays.py` and
`reconstruct.fit`), nor what has to stay where it is.
"""

import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import cache
from typing import Any, Final

import torch
import warp as wp

from gs2ci.render.places import is_apart

wp.config.log_level = wp.LOG_ERROR
# On the CPU, blocks have so many logical threads (fibers), as on CUDA; otherwise each would have one, without a word.
wp.config.enable_cpu_blocks = True

TILED: Final[dict[str, Any]] = {"enable_backward": False, "max_unroll": 32, "enable_mathdx_gemm": False}
"""Options of kernels that use tiles; these need a module of their own (warp 1.19)."""
Floats, Doubles, Ints = wp.array(dtype=wp.float32), wp.array(dtype=wp.float64), wp.array(dtype=wp.int32)
Vectors, Fours = wp.array(dtype=wp.vec3), wp.array(dtype=wp.vec4)
"""Types of arrays that kernels are given."""
_FIBERS: Final = threading.RLock()
_CAPTURING: Final = threading.Lock()


class _State:
    """What became of captures in this process.

    Args:
        refusal: Why one was refused; none is tried again.
        captured: How many there were.
    """

    refusal: str | None = None
    captured: int = 0


def refusal() -> str | None:
    """Return why the driver refused to capture a graph, in its own words; None if it never did."""
    return _State.refusal


def captured() -> int:
    """Return how many graphs were captured so far."""
    return _State.captured


def one_at_a_time(device: str) -> AbstractContextManager[object]:
    """Keep fibers of two host threads apart: they would share one stack of tiles, and end the process (warp 1.19)."""
    return _FIBERS if device == "cpu" else nullcontext()


class Launcher:
    """Launches kernels on a device.

    Args:
        device: A name of Warp's.
        stream: The stream; None: the device's present one.
    """

    def __init__(self, device: str, stream: Any = None) -> None:
        self._device, self._stream = device, stream

    def __call__(self, kernel: Any, dim: int | tuple[int, ...], inputs: Sequence[Any], outputs: Sequence[Any]) -> None:
        """Launch a kernel of so many threads; of none, nothing."""
        if dim and (isinstance(dim, int) or all(dim)):
            wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self._device, stream=self._stream)

    def blocks(self, kernel: Any, blocks: int, threads: int, inputs: Sequence[Any], outputs: Sequence[Any]) -> None:
        """Launch so many blocks of threads."""
        if blocks:
            with one_at_a_time(self._device):
                wp.launch_tiled(
                    kernel,
                    dim=[blocks],
                    block_dim=threads,
                    inputs=inputs,
                    outputs=outputs,
                    device=self._device,
                    stream=self._stream,
                )


Launches = Callable[[Launcher], None]
"""Launches kernels, and does nothing else: it allocates nothing, and nothing that it does depends on numbers."""


class Recording:
    """One such function, called or replayed.

    Args:
        device: A name of Warp's.
        launches: The function.
    """

    def __init__(self, device: str, launches: Launches) -> None:
        self._device, self._launches = device, launches
        self._called = False
        self._graph: Any = None

    @property
    def replays(self) -> bool:
        """Get whether the next run replays a graph."""
        return self._graph is not None

    def forget(self) -> None:
        """Call the function again when it is run next: arrays that it is given have moved."""
        self._called, self._graph = False, None

    def run(self) -> None:
        """Do what the function does: the first time by calling it, then by replaying what it launches."""
        if self._graph is None and self._called and _may_capture(self._device):
            self._graph = _capture(self._device, self._launches)
        if self._graph is not None and not _replay(self._device, self._graph):
            self._graph = None
        if self._graph is None:
            self._launches(Launcher(self._device))
            self._called = True


def _may_capture(device: str) -> bool:
    return _State.refusal is None and is_apart(torch.device("cpu" if device == "cpu" else "cuda"))


def _capture(device: str, launches: Launches) -> Any:
    """Return a graph of what a function launches, without running it; None if that is refused."""
    with _CAPTURING, one_at_a_time(device):
        stream = None if device == "cpu" else _aside(device)
        try:
            with wp.ScopedCapture(device=device, stream=stream) as capture:
                launches(Launcher(device, stream))
        except RuntimeError as error:
            _refuse(error)
            return None
    _State.captured += 1
    return capture.graph


def _replay(device: str, graph: Any) -> bool:
    """Replay a graph; False: the driver refuses to make a program of it or to launch it, and nothing has run."""
    try:
        with one_at_a_time(device):
            wp.capture_launch(graph)
    except RuntimeError as error:
        _refuse(error)
        return False
    return True


def _refuse(error: RuntimeError) -> None:
    _State.refusal = (str(error).strip().splitlines() or ["no reason given"])[0].rstrip(".")


@cache
def _aside(device: str) -> Any:
    """Return a stream for captures: Warp's, or, since torch's usual one cannot be captured, another one of torch's.

    Always the same: torch hands out its 32 streams in turn, and Warp would forget one that is in use when an earlier
    object of the same stream goes.
    """
    if torch.cuda.is_available():
        another: Any = torch.cuda.Stream
        return wp.stream_from_torch(another(device))
    return wp.get_stream(device)
