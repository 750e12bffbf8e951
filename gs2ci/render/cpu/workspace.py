"""Buffers that outlive an iteration.

A rendering needs some tens of megabytes. Fresh memory of that size is handed out page by page by the system and costs
milliseconds per iteration, so buffers are kept and only ever grow. Each rendering whose gradient is still wanted leases
a workspace of its own; a pool takes back what is released.
"""

import math
import threading
from typing import Any, Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

CACHE_LINE_BYTES: Final = 64
_GROWTH: Final = 1.1


class Workspace:
    """Named grow-only buffers, aligned to cache lines, with undefined contents."""

    def __init__(self) -> None:
        self._buffers: dict[str, NDArray[Any]] = {}

    def get(self, name: str, shape: tuple[int, ...], dtype: DTypeLike = np.float32) -> NDArray[Any]:
        """Return the buffer of this name, large enough for `shape`, contents undefined."""
        size = math.prod(shape)
        buffer = self._buffers.get(name)
        if buffer is None or buffer.size < size:
            buffer = _aligned(int(size * _GROWTH), np.dtype(dtype))
            self._buffers[name] = buffer
        return buffer[:size].reshape(shape)

    def capacity(self, name: str) -> int:
        """Get how many elements the buffer of this name holds; 0 if there is none."""
        buffer = self._buffers.get(name)
        return 0 if buffer is None else int(buffer.size)

    @property
    def nbytes(self) -> int:
        """Get the memory held, in bytes."""
        return sum(buffer.nbytes for buffer in self._buffers.values())


def _aligned(size: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    spare = CACHE_LINE_BYTES // dtype.itemsize
    raw = np.empty(size + spare, dtype)
    shift = (-raw.ctypes.data % CACHE_LINE_BYTES) // dtype.itemsize
    return raw[shift : shift + size]


class Pool:
    """Workspaces waiting for the next rendering; at most `keep` of them, the rest is freed."""

    def __init__(self, keep: int = 2) -> None:
        self._keep = keep
        self._idle: list[Workspace] = []
        # Reentrant: the garbage collector may run anywhere within, and free a forgotten lease in the same thread.
        self._lock = threading.RLock()

    def lease(self) -> "Lease":
        """Hand out a workspace, used before if there is one."""
        with self._lock:
            return Lease(self, self._idle.pop() if self._idle else Workspace())

    def take_back(self, workspace: Workspace) -> None:
        """Keep a workspace for the next lease."""
        with self._lock:
            self._idle.append(workspace)
            del self._idle[self._keep :]

    def forget(self) -> None:
        """Free what waits."""
        with self._lock:
            self._idle.clear()

    @property
    def idle(self) -> int:
        """Get how many workspaces are waiting."""
        return len(self._idle)


class Lease:
    """A workspace in use; given back by `release`, or when no reference to the lease remains."""

    def __init__(self, pool: Pool, workspace: Workspace) -> None:
        self._pool = pool
        self._workspace: Workspace | None = workspace

    @property
    def workspace(self) -> Workspace | None:
        """Get the workspace, None once released."""
        return self._workspace

    def release(self) -> None:
        """Give the workspace back; doing so twice is harmless."""
        workspace, self._workspace = self._workspace, None
        if workspace is not None:
            self._pool.take_back(workspace)

    def __del__(self) -> None:
        self.release()
