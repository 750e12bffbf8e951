"""A ring buffer of shots between acquisition and the disk.

A thread of its own writes shots while the next ones are exposed. If the disk is slower, shots wait in the ring; if the
ring is full, the acquisition waits too (back-pressure), and frames that the sensor's own buffers cannot hold meanwhile
are lost there and named by their numbers. Memory never holds more shots than the ring.

Here: `WritingRing`. Not here: what is written (`recording`), lost frames (`gs2ci_drivers.acquisition`).
"""

import threading
import time
from collections.abc import Callable
from queue import Queue
from typing import Self

from gs2ci.core.errors import InputError
from gs2ci_drivers.acquisition import Taken


class WritingRing:
    """Passes shots to a sink in a thread of its own, in order.

    Use it as a context manager: its end waits until all shots are written, and raises an error of the sink.

    Args:
        sink: Writes one shot.
        size: How many may wait.

    Raises:
        InputError: The size is below 1.
    """

    def __init__(self, sink: Callable[[Taken], None], size: int) -> None:
        if size < 1:
            raise InputError(f"a ring of {size}", allowed="1 or more", remedy="set `ring` in [capture]")
        self.size = size
        self.fullest = 0
        """The largest number of shots that waited."""
        self.waits = 0
        """How often the ring was full."""
        self.waited_s = 0.0
        """How long the acquisition waited in total."""
        self._sink = sink
        self._queue: Queue[Taken | None] = Queue(size)
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._write, name="writing ring", daemon=True)

    def put(self, taken: Taken) -> None:
        """Queue a shot; waits while the ring is full.

        Raises:
            BaseException: The sink's error on an earlier shot; this one is not written.
        """
        self._raise()
        if self._queue.full():
            self.waits += 1
            began_s = time.monotonic()
            self._queue.put(taken)
            self.waited_s += time.monotonic() - began_s
        else:
            self._queue.put(taken)
        self.fullest = max(self.fullest, self._queue.qsize())

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._queue.put(None)
        self._thread.join()
        if error is None:
            self._raise()

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def _write(self) -> None:
        """Write the queued shots; after an error, discard them, so that no producer blocks for ever."""
        while (taken := self._queue.get()) is not None:
            if self._error is None:
                try:
                    self._sink(taken)
                except BaseException as error:
                    self._error = error
