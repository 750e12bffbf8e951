"""Running blocking driver calls in a thread of their own, so that Bluesky's event loop is never blocked.

Here: `Worker`. Not here: what is called (`axis`, `masks`, `camera`, `coded`).
"""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, TypeVar

T = TypeVar("T")

SLICE_S: Final = 5e-3
"""Longest wait of one call, so that other work can run in between: stopping, reading, showing at 60 Hz."""


class Worker:
    """The only thread that calls a bench's devices, one call after another, as `gs2ci_drivers` requires."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="gs2ci device")

    async def __call__(self, call: Callable[..., T], *args: Any, **given: Any) -> T:
        """Make a call there and wait for what it returns or raises."""
        return await asyncio.get_running_loop().run_in_executor(self._pool, lambda: call(*args, **given))

    def now(self, call: Callable[..., T], *args: Any) -> T:
        """Do the same without an event loop; blocks."""
        return self._pool.submit(call, *args).result()

    def close(self) -> None:
        """End the thread after its pending calls."""
        self._pool.shutdown()
