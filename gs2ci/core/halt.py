"""The request to end early with the result so far, which long computations check between their steps.

Here: the request; Ctrl-C, `kill` and a closed terminal as the request, or as an exception. Not here: the result that a
computation returns then (`gs2ci.reconstruct.pipeline`).
"""

import os
import signal
import stat
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from gs2ci.core.findings import Findings
    from gs2ci.core.progress import Progress

ENDINGS: Final = (signal.SIGTERM, signal.SIGHUP)


class Halt:
    """Holds the request to end early with the result so far.

    A computation calls `begin` as soon as it has a result. Threads may request and check.

    Args:
        answer: What a user is told who requests it.
    """

    def __init__(
        self, answer: str = "It ends with what it has found so far; a second interruption discards that."
    ) -> None:
        self.answer = answer
        self._begun = threading.Event()
        self._asked = threading.Event()

    @property
    def asked(self) -> bool:
        """Get whether an early end was requested."""
        return self._asked.is_set()

    def begin(self) -> None:
        """Declare that a result exists from now on."""
        self._begun.set()

    def ask(self) -> bool:
        """Request the result so far; return False if there is none yet, or if it was requested before."""
        if not self._begun.is_set() or self.asked:
            return False
        self._asked.set()
        return True

    def told(self, progress: "Progress") -> "Findings":
        """Report that an early end was requested, if it was."""
        # Every command sets the handlers as it starts, and few come to a finding.
        from gs2ci.core.findings import Code, finding  # noqa: PLC0415
        from gs2ci.core.progress import said  # noqa: PLC0415

        return said((finding(Code.INTERRUPTED),) if self.asked else (), progress)


def end(number: int, _frame: FrameType | None) -> None:
    """Unwind as Ctrl-C does, so that what is open is closed: the command line's handler of `ENDINGS`.

    Raises:
        SystemExit: Always, with the status of a process that the signal ended.
    """
    _leave_terminal(number)
    raise SystemExit(128 + number)


@contextmanager
def halted_by_interruption(halt: Halt, say: Callable[[str], None], *, told_to_end: bool = True) -> Iterator[None]:
    """Let Ctrl-C, or a notebook's stop button, request the result so far; if there is none, interrupt as usual.

    In a thread, or if another handler is installed for a signal, nothing is changed: Python delivers signals only to
    the main thread.

    Args:
        halt: Receives the request.
        say: Told what follows when the request is made.
        told_to_end: Whether `kill` and a closed terminal request it as well, within the command line.

    Raises:
        KeyboardInterrupt: There is no result yet, or it was requested before.
        SystemExit: The same, after `kill` or a closed terminal.
    """
    main = threading.current_thread() is threading.main_thread()
    usual = {signal.SIGINT: signal.default_int_handler} | dict.fromkeys(ENDINGS if told_to_end else (), end)
    taken = {number: handler for number, handler in usual.items() if main and signal.getsignal(number) is handler}

    def interrupt(number: int, frame: FrameType | None) -> None:
        _leave_terminal(number)
        if not halt.ask():
            usual[signal.Signals(number)](number, frame)
        with suppress(RuntimeError):  # the signal came within a write to the same output
            say(halt.answer)

    for number in taken:
        signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number, handler in taken.items():
            signal.signal(number, handler)


def _leave_terminal(number: int) -> None:
    """Print nowhere from now on if the terminal was closed: the error of a refused line would end the work.

    A shell and the system both send the signal; the second is not to end what the first one began.
    """
    if number != signal.SIGHUP:
        return
    signal.signal(number, signal.SIG_IGN)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for output in (1, 2):
        with suppress(OSError):
            if stat.S_ISCHR(os.fstat(output).st_mode):
                os.dup2(nowhere, output)
    os.close(nowhere)
