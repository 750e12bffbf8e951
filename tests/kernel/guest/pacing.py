"""Lets a twin's virtual time pass with the guest's, so that a twin can stand behind a real kernel interface."""

import threading
import time
from collections.abc import Callable

from gs2ci_sims.world import VirtualClock

TICK_S = 0.002


class Pace:
    """A thread that keeps a virtual clock up with real time and calls `pump` after every step.

    Whoever touches the twin takes `lock`; `catch_up` may be called with it held.

    Args:
        clock: The twin's clock.
        pump: Moves what the twin has to say on to the kernel; called with the lock held.
    """

    def __init__(self, clock: VirtualClock, pump: Callable[[], None]) -> None:
        self.lock = threading.RLock()
        self._clock = clock
        self._pump = pump
        self._offset_s = clock.now_s() - time.monotonic()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def catch_up(self) -> None:
        """Let virtual time pass up to now."""
        self._clock.sleep_s(time.monotonic() + self._offset_s - self._clock.now_s())

    def _run(self) -> None:
        while not self._done.wait(TICK_S):
            with self.lock:
                self.catch_up()
                self._pump()

    def stop(self) -> None:
        """End the thread."""
        self._done.set()
        self._thread.join()
