"""`gs2ci tables`: tables of figures, computed cell by cell; an interrupted table can be continued.

Here: the arguments and what is printed. Not here: the work (`gs2ci.api.costs`).
"""

import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import tyro

from gs2ci.api.costs import make_table
from gs2ci.api.derived import with_options_of
from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.printed_pages import print_pages
from gs2ci.tables.names import TableName


@with_options_of(make_table, without=("command", "progress"))
def run(
    table: Annotated[TableName, tyro.conf.Positional],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("tables"),
    *,
    data: Path | None = None,
    cases: tuple[str, ...] = (),
    lines: tuple[str, ...] = (),
    json: AsJson = False,
    **options: Any,
) -> list[Path]:
    """Make one table of figures: mean and spread over seeds, as markdown, CSV, a picture and an HTML page.

    Finished cells are kept under their content's hash in `<output>/cells`: a repeated command continues an interrupted
    table, and measures again if program, file or settings have changed. Times are meaningful only with one process on
    an idle machine.

    Args:
        table: Which table.
        output: Folder for the pages and the finished cells.

    Returns:
        The pages.

    Raises:
        Gs2ciError: A name is unknown, a file cannot be read, a table has no files or no size to choose, or no
            scheduler answers.
    """
    command = shlex.join(["gs2ci", *sys.argv[1:]])
    with answered(as_text=not json) as answer:
        made = make_table(table, output, data=data, cases=cases, lines=lines, command=command, **options)
        print_pages(made.text, made.pages)
        answer({"table": table, "lines": made.records(), "pages": made.pages})
    return made.pages
