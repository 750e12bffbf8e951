"""Lines and tables that commands print for people. Not here: answers for programs (`answers`), pages."""

from collections.abc import Iterable, Sequence

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


def print_table(headings: Sequence[str], rows: Iterable[Sequence[str]], title: str | None = None) -> None:
    """Print a table without lines; a row that ends in "NO" is red."""
    table = Table(*headings, box=None, pad_edge=False, title=title, title_justify="left", title_style="bold")
    table.show_header = bool(headings)
    for row in rows:
        table.add_row(*map(Text, row), style="bold red" if row[-1] == "NO" else "")
    Console(highlight=False).print(table)
