"""`python -m tests.tables TABLE`: tables of figures, computed cell by cell; an interrupted table can be continued.

names.py       what the tables are called
cases.py       what is measured: shared measurements, simulated scenes, recoded with other masks if wanted
case_sets.py   the measurements that a table is made over
variants.py    what is compared: named changes to the reconstruction's settings
cells.py       one piece of work, and doing it; kept as finished trials are (`gs2ci.evaluate.tradeoff.store`)
works.py       the kinds of work there are; simulation.py, calibration.py and literature.py hold more
field_fit.py   a radiance field for comparison, as in SCINeRF; radiance_field.py: the field and its rendering
workers.py     who does the work: this process, others of this machine, or a Dask cluster
columns.py     the columns that tables have
catalogue.py   which cells make which table, and how they are laid out
pages.py       means and spreads; markdown, CSV and a picture
making.py      all of it, in order
"""

import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import tyro

import gs2ci.cli  # noqa: F401  first: it says how threads wait, before any library with threads is loaded
from gs2ci.api.derived import with_options_of
from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.printed_pages import print_pages
from gs2ci.core.errors import Gs2ciError
from tests.tables.making import make_table
from tests.tables.names import TableName


@with_options_of(make_table, without=("command", "progress"))
def run(
    table: Annotated[TableName, tyro.conf.Positional],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("tables"),
    *,
    data: Path | None = None,
    cases: tuple[str, ...] = (),
    lines: tuple[str, ...] = (),
    only: tuple[str, ...] = (),
    json: AsJson = False,
    **options: Any,
) -> list[Path]:
    """Make one table of figures: mean and spread over seeds, as markdown, CSV and a picture.

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
    command = shlex.join(["python", "-m", "tests.tables", *sys.argv[1:]])
    with answered(json) as answer:
        made = make_table(table, output, data=data, cases=cases, lines=lines, only=only, command=command, **options)
        print_pages(made.text, made.pages)
        answer({"table": table, "lines": made.records(), "pages": made.pages})
    return made.pages


def main(words: list[str] | None = None) -> int:
    """Make the table that a command line names; return the exit status."""
    try:
        tyro.cli(run, prog="python -m tests.tables", args=words)
    except Gs2ciError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
