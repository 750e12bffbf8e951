"""A command's answer to a program: JSON on standard output, and all other output on standard error.

Here: `answered`, for the option `--json`; `silenced`, for the option `--quiet`. Not here: the answers' contents.
"""

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from typing import Annotated, Any, Final, TextIO

import tyro

from gs2ci.core.json_text import as_json

AsJson = Annotated[bool, tyro.conf.arg(help="Print the answer as JSON, and nothing else, on standard output.")]
"""The option `--json` of every command that has one."""
# Destination of answers while all other output is silenced.
_answers_to: Final[ContextVar[TextIO | None]] = ContextVar("answers_to", default=None)
QUIET_VARIABLE: Final = "GS2CI_QUIET"
"""For displays, also of processes that a command starts (`gs2ci.api.display`)."""


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Limit a command's output to errors, questions and answers as JSON."""
    before = os.environ.get(QUIET_VARIABLE)
    os.environ[QUIET_VARIABLE] = "1"
    token = _answers_to.set(sys.stdout)
    try:
        with open(os.devnull, "w", encoding="utf-8") as nowhere, contextlib.redirect_stdout(nowhere):
            yield
    finally:
        _answers_to.reset(token)
        if before is None:
            del os.environ[QUIET_VARIABLE]
        else:
            os.environ[QUIET_VARIABLE] = before


@contextlib.contextmanager
def answered(alone: bool) -> Iterator[Callable[[Any], None]]:
    """Let a command give its answer.

    Args:
        alone: Whether standard output is to contain the answer alone, and all other output goes to standard error.
            Otherwise the output is for people: nothing is changed, and the answer is not printed.

    Yields:
        A function that takes the answer, of plain values, records and arrays.
    """
    if not alone:
        yield lambda _answer: None
        return
    before = _answers_to.get()
    out, rest = before or sys.stdout, sys.stderr if before is None else sys.stdout
    with contextlib.redirect_stdout(rest):
        yield lambda answer: print(as_json(answer), end="", file=out, flush=True)
