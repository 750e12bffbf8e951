"""The request to end early with what has been found so far, which long computations check between their steps.

Here: the request, and Ctrl-C as the request. Not here: what a computation hands over then
(`gs2ci.reconstruct.pipeline`).
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Halt:
    """Says whether to end early, with what there is.

    A computation says from when on there is something to hand over (`begin`). Threads may ask and look.
    """

    def __init__(self) -> None:
        self._begun = threading.Event()
        self._asked = threading.Event()

    @property
    def asked(self) -> bool:
        """Get whether an early end was requested."""
        return self._asked.is_set()

    def begin(self) -> None:
        """Say that a result as it is can be had from now on."""
        self._begun.set()

    def ask(self) -> bool:
        """Ask for the result as it is; return False where there is none yet, or where that was asked before."""
        if not self._begun.is_set() or self.asked:
            return False
        self._asked.set()
        return True


@contextmanager
def halted_by_interruption(halt: Halt) -> Iterator[None]:
    """Let Ctrl-C, or a notebook's stop button, ask for what there is; where that cannot be asked, interrupt as ever.

    In a thread, or where somebody else handles the signal, nothing is changed: Python delivers signals to the main
    thread alone.

    Args:
        halt: What is asked.

    Raises:
        KeyboardInterrupt: There is nothing to hand over yet, or this was the second Ctrl-C.
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
