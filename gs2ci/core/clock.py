"""Time as a parameter: a clock that code waits on, so that a simulated second need not cost a real one.

Here: the interface and the wall clock. Not here: the simulated world's clock (`gs2ci_sims.world`).
Anyone may import this file.
"""

import time
from typing import Protocol

import psutil


class Clock(Protocol):
    """A monotonic clock that can be waited on."""

    def now_s(self) -> float:
        """Get the time in seconds since an arbitrary origin; never decreases."""
        ...

    def sleep_s(self, duration_s: float) -> None:
        """Let `duration_s` seconds pass on this clock (values below 0 count as 0)."""
        ...


def process_age_s() -> float:
    """Measure how long ago the operating system started this process, in seconds.

    What a user waits for includes the interpreter's start and the loading of libraries, which takes seconds here.
    """
    return max(0.0, time.time() - psutil.Process().create_time())


class WallClock:
    """The computer's own monotonic clock."""

    def now_s(self) -> float:
        """Get the monotonic time in seconds."""
        return time.monotonic()

    def sleep_s(self, duration_s: float) -> None:
        """Block for `duration_s` seconds."""
        if duration_s > 0:
            time.sleep(duration_s)
