"""Pages of figures in a terminal: their markdown with tables that fit its width, then the paths of their files.

Not here: the figures and the files (`gs2ci.api.costs`).
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from pathlib import Path

from rich.console import Console
from rich.markdown import Markdown

from gs2ci.commands.lines import say

# The space that rich leaves beside the text of a table's column, characters.
_BESIDE = 2


def print_pages(text: str, pages: Iterable[Path]) -> None:
    """Print the markdown of pages, and where they were written.

    Args:
        text: The markdown.
        pages: The files.
    """
    console = Console()
    console.print(Markdown(split_tables(text, console.width)))
    for page in pages:
        say(page)


def split_tables(text: str, width: int) -> str:
    """Split each table that is wider than a terminal into tables of fewer columns; each repeats the first column.

    Otherwise the cells of a table with many columns would be cut off after a letter or two.

    Args:
        text: Markdown, without "|" inside a table's cells.
        width: Of the terminal, in characters.
    """
    parts: list[str] = []
    for is_table, together in groupby(text.split("\n"), key=lambda line: line.startswith("|")):
        lines = list(together)
        parts += _split([_cells(line) for line in lines], width) if is_table else lines
    return "\n".join(parts)


def _split(rows: Sequence[Sequence[str]], width: int) -> Iterator[str]:
    widths = [max(_printed_width(row[column]) for row in rows) + _BESIDE for column in range(len(rows[0]))]
    group: list[int] = []
    for column in range(1, len(widths)):
        if group and widths[0] + sum(widths[one] for one in (*group, column)) > width:
            yield from (_line(row, group) for row in rows)
            yield ""
            group = []
        group.append(column)
    yield from (_line(row, group) for row in rows)


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().removeprefix("|").removesuffix("|").split("|")]


def _line(row: Sequence[str], columns: Sequence[int]) -> str:
    return "| " + " | ".join((row[0], *(row[column] for column in columns))) + " |"


def _printed_width(cell: str) -> int:
    """Return the width of a cell without the marks of bold text and code; a rule under a heading takes no width."""
    return 0 if re.fullmatch(r":?-+:?", cell) else len(re.sub(r"[*`]", "", cell))
