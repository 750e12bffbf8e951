"""Lines and tables that commands print for people. Not here: answers for programs (`answers`), pages."""

import shlex
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text


def say(*parts: object, style: str = "", aside: bool = False) -> None:
    """Print a line as it stands: nothing in it is markup, and it is broken nowhere, so that paths can be copied.

    Args:
        parts: What the line is made of; every second part is bold.
        style: Of the whole line.
        aside: Print it on standard error.
    """
    line = Text(style=style)
    for number, part in enumerate(parts):
        line.append(str(part), "bold" if number % 2 else None)
    Console(stderr=aside, highlight=False).print(line, soft_wrap=True)


def say_next(*words: object) -> None:
    """Print the command that comes next, as a shell takes it."""
    say("next: ", shlex.join(["gs2ci", *map(str, words)]))


def say_what_reconstructs(shots: Path, count: int, *, one_scene: bool) -> None:
    """Print the command that reconstructs a file.

    Args:
        shots: The shot file.
        count: Its exposures.
        one_scene: Whether all are of one scene that stands still, as those of a bench are.
    """
    if count == 1:
        say_next("reconstruct", shots, "-o", "run/")
    elif one_scene:
        say_next("reconstruct", shots, "--together", "-o", "run/")
    else:
        say_next("reconstruct", shots, "--all", "-o", "runs/")


@contextmanager
def kept_if_interrupted(what: str) -> Iterator[None]:
    """Say after an interruption that the same command goes on: with all but `what`, which is kept."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        say(f"{what} are kept: the same command goes on with the others", aside=True)
        raise


def print_table(headings: Sequence[str], rows: Iterable[Sequence[str]], title: str | None = None) -> None:
    """Print a table without lines; a row that ends in "NO" is red."""
    table = Table(*headings, box=None, pad_edge=False, title=title, title_justify="left", title_style="bold")
    table.show_header = bool(headings)
    for row in rows:
        table.add_row(*map(Text, row), style="bold red" if row[-1] == "NO" else "")
    Console(highlight=False).print(table)
