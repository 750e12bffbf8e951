"""The request to end early with the result so far, which long computations check between their steps.

Here: the request, and Ctrl-C as the request. Not here: the result that a computation returns then
(`gs2ci.reconstruct.pipeline`).
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Halt:
    """Holds the request to end early with the result so far.

    A computation calls `begin` as soon as it has a result. Threads may request and check.
    """

    def __init__(self) -> None:
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


@contextmanager
def halted_by_interruption(halt: Halt) -> Iterator[None]:
    """Let Ctrl-C, or a notebook's stop button, request the result so far; if there is none, interrupt as usual.

    In a thread, or if another handler is installed for the signal, nothing is changed: Python delivers signals only to
    the main thread.

    Args:
        halt: Receives the request.

    Raises:
        KeyboardInterrupt: There is no result yet, or this was the second Ctrl-C.
    """
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return

    def interrupt(number: int, frame: object) -> None:
        if not halt.ask():
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
