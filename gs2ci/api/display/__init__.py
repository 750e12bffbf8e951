"""Showing the progress of a long computation: at a terminal, in a notebook, in a file.

Here: the choice of a display, a caller's own listener in its place, and an interruption within compiled code. Not
here: the state of a stage that all displays share (`stages`), drawing (`terminal`, `notebook`, `plain`).
"""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from rich.console import Console

from gs2ci.api.display.notebook import NotebookDisplay
from gs2ci.api.display.plain import PlainDisplay, QuietDisplay
from gs2ci.api.display.stages import StageDisplay
from gs2ci.api.display.terminal import LiveDisplay
from gs2ci.core.progress import Progress

# Set by `gs2ci --quiet`, also for processes started from there.
QUIET_VARIABLE: Final = "GS2CI_QUIET"


def open_display(console: Console | None = None) -> StageDisplay:
    """Choose the display by the output: live on a terminal, a bar in a notebook, plain lines otherwise.

    Args:
        console: Where to show; standard output if None.
    """
    if is_quiet():
        return QuietDisplay(console or Console(stderr=True, highlight=False))
    if console is None and in_notebook():
        return NotebookDisplay()
    console = console or Console(highlight=False)
    return LiveDisplay(console) if console.is_terminal else PlainDisplay(console)


def is_quiet() -> bool:
    """Tell whether the user asked for silence, by `--quiet` or by the variable GS2CI_QUIET."""
    return os.environ.get(QUIET_VARIABLE, "") not in ("", "0")


def in_notebook() -> bool:
    """Tell whether this process is a notebook's kernel, whose cells show HTML."""
    # A process that has not imported IPython by now does not run under it.
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return shell is not None and hasattr(shell, "kernel")


@contextmanager
def shown(progress: Progress | None) -> Iterator[StageDisplay]:
    """Provide a listener: the caller's own, which stays open, or a display that is closed at the end."""
    if progress is not None:
        yield _Caller(progress)
        return
    with open_display() as display:
        yield display


@contextmanager
def interrupted_within() -> Iterator[None]:
    """Raise KeyboardInterrupt for an interruption that compiled code has turned into another error.

    Raises:
        KeyboardInterrupt: The user interrupted.
    """
    try:
        yield
    except SystemError as error:
        if stems_from_interruption(error):
            raise KeyboardInterrupt from error
        raise


def stems_from_interruption(error: BaseException | None) -> bool:
    """Tell whether Ctrl-C came while compiled code was being entered: Numba makes it the cause of another error."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


class _Caller(StageDisplay):
    """A caller's own listener as a display: methods that it lacks are skipped."""

    def __init__(self, listener: Progress) -> None:
        super().__init__()
        self._listener = listener

    def stage(self, name: str, total: int | None = None) -> None:
        """Pass it on."""
        self._listener.stage(name, total)

    def expect(self, total: int) -> None:
        """Pass it on."""
        self._listener.expect(total)

    def step(self, done: int, **figures: float | int | str) -> None:
        """Pass it on."""
        self._listener.step(done, **figures)

    def say(self, text: str) -> None:
        """Pass it on."""
        self._listener.say(text)

    def ask(self, request: str) -> None:
        """Ask through the listener if it can, otherwise by a sentence and Enter."""
        own: Callable[[str], None] = getattr(self._listener, "ask", super().ask)
        own(request)

    def finish(self) -> None:
        """End the running stage if the listener can."""
        own: Callable[[], None] = getattr(self._listener, "finish", lambda: None)
        own()
