"""Time as a parameter: a clock on which code waits, so that a simulated second does not take a real one.

Here: the interface and the wall clock. Not here: the simulated world's clock (`gs2ci_sims.world`).
"""

import time
from contextvars import ContextVar
from typing import Final, Protocol

_command_began_s: Final[ContextVar[float | None]] = ContextVar("command_began_s", default=None)


class Clock(Protocol):
    """A monotonic clock that can be waited on."""

    def now_s(self) -> float:
        """Get the time in seconds since an arbitrary origin; never decreases."""

    def sleep_s(self, duration_s: float) -> None:
        """Let `duration_s` seconds pass on this clock (values below 0 count as 0)."""


def begin_command() -> None:
    """Record that this process runs one command, whose user has been waiting since the process began.

    Starting the interpreter and loading libraries take seconds, which a time budget has to include.
    """
    # Drivers use this module on computers without the command line and without this library.
    import psutil  # noqa: PLC0415

    _command_began_s.set(time.monotonic() - max(0.0, time.time() - float(psutil.Process().create_time())))


def command_age_s() -> float:
    """Return how long the user of the running command has waited, in seconds; 0 if no command runs."""
    began_s = _command_began_s.get()
    return 0.0 if began_s is None else time.monotonic() - began_s


class WallClock:
    """The computer's own monotonic clock."""

    def now_s(self) -> float:
        """Get the monotonic time in seconds."""
        return time.monotonic()

    def sleep_s(self, duration_s: float) -> None:
        """Block for `duration_s` seconds."""
        if duration_s > 0:
            time.sleep(duration_s)
