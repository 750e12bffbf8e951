"""`gs2ci tables`: tables of figures, made cell by cell, resumed where they were left.

Here: the arguments, and the order cells → rows → pages. Not here: any of the three (`gs2ci.tables`).
"""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.markdown import Markdown

from gs2ci.commands.display import open_display
from gs2ci.commands.options import check_whole
from gs2ci.core.errors import InputError
from gs2ci.core.whole_file import check_place
from gs2ci.tables.names import TableName


def run(
    table: Annotated[TableName, tyro.conf.Positional],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("tables"),
    *,
    data: Path | None = None,
    size: tuple[int, int] | None = None,
    cases: tuple[str, ...] = (),
    lines: tuple[str, ...] = (),
    seeds: int = 3,
    processes: int = 1,
    scheduler: str = "",
    fresh: bool = False,
) -> list[Path]:
    """Make one table of figures: mean and spread over seeds, as markdown, CSV, a picture and an HTML page.

    Finished cells are kept under their content's hash in `<output>/cells`: an interrupted table goes on where it was
    left, and a changed program, file or setting is measured anew. Times are only worth reading with one process on a
    quiet machine.

    Args:
        table: Which one.
        output: Folder for the pages and the finished cells.
        data: Folder of .npz measurements to use instead of simulated scenes; of rig files (.toml) for simulate.
        size: Height and width, px: of the simulated scenes, instead of 192 256; of files, the middle that is kept.
            For what would take hours.
        cases: Only these of the cases.
        lines: Only these lines of the table.
        seeds: How many seeds.
        processes: Local processes to share the work.
        scheduler: Address of a Dask scheduler to do the work instead, e.g. tcp://host:8786.
        fresh: Measure everything again.

    Returns:
        The pages.

    Raises:
        Gs2ciError: A name is unknown, a file cannot be read, a table has no files or no size to choose, or no
            scheduler answers.
    """
    check_whole("--seeds", seeds, 1, 1000)
    check_whole("--processes", processes, 1, 1000)
    for side_px in size or ():
        check_whole("--size", side_px, 1, 100_000)
    from gs2ci.tables.catalogue import TABLES, TableOptions, known_cases
    from gs2ci.tables.html_page import write_html_page
    from gs2ci.tables.pages import collect, markdown, write_pages
    from gs2ci.tables.store import Store
    from gs2ci.tables.workers import complete

    if table not in TABLES:
        raise InputError(f"no table {table!r}", allowed=", ".join(TABLES))
    chosen = TABLES[table]
    known = known_cases(table, data, size)
    unknown = [case for case in cases if case not in {one.name for one in known}]
    if unknown:
        raise InputError(f"case {unknown[0]!r} is unknown", allowed=", ".join(one.name for one in known))
    options = TableOptions(tuple(one for one in known if not cases or one.name in cases), seeds, lines)
    entries = chosen.entries(options)
    check_place(output / "cells")
    with open_display() as display:
        display.stage(f"bench {table}", len(entries))
        rows = complete(
            [entry.cell for entry in entries],
            Store(output / "cells", fresh=fresh),
            processes=processes,
            scheduler=scheduler,
            heard=lambda done, _total: display.step(done),
        )
    figures = collect(chosen, entries, rows)
    command = shlex.join(["gs2ci", *sys.argv[1:]])
    pages = write_pages(output, table, chosen, figures, command)
    pages.append(write_html_page(output, table, chosen, figures, command))
    console = Console()
    console.print(Markdown(markdown(chosen, figures, command)))
    for page in pages:
        console.print(str(page), soft_wrap=True)
    return pages
