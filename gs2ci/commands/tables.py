"""`gs2ci tables`: tables of figures, made cell by cell, resumed where they were left.

Here: the arguments and what is printed. Not here: the work (`gs2ci.api.costs`).
"""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.markdown import Markdown

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
    from gs2ci.api.costs import make_table

    made = make_table(
        table,
        output,
        data=data,
        size=size,
        cases=cases,
        lines=lines,
        seeds=seeds,
        processes=processes,
        scheduler=scheduler,
        fresh=fresh,
        command=shlex.join(["gs2ci", *sys.argv[1:]]),
    )
    console = Console()
    console.print(Markdown(made.text))
    for page in made.pages:
        console.print(str(page), soft_wrap=True)
    return made.pages
