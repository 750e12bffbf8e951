"""Running blocking driver calls in a thread of their own, so that Bluesky's event loop is never blocked.

Here: `Worker`. Not here: what is called (`axis`, `masks`, `camera`, `coded`).
"""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, TypeVar

T = TypeVar("T")

SLICE_S: Final = 5e-3
"""Longest wait of one call where something else may have to be done meanwhile: stopped, read out, shown at 60 Hz."""


class Worker:
    """The one thread that speaks to a bench's devices, one call behind another, as `gs2ci_drivers` expects it."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="gs2ci device")

    async def __call__(self, call: Callable[..., T], *args: Any, **given: Any) -> T:
        """Make a call there and wait for what it returns or raises."""
        return await asyncio.get_running_loop().run_in_executor(self._pool, lambda: call(*args, **given))

    def now(self, call: Callable[..., T], *args: Any) -> T:
        """Do the same where no event loop runs; blocks."""
        return self._pool.submit(call, *args).result()

    def close(self) -> None:
        """End the thread once what was asked is done."""
        self._pool.shutdown()
