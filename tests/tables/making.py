"""Making one table: its cells, its rows and its pages.

Here: the order of these. Not here: any of them.
"""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gs2ci.api.display import shown
from gs2ci.api.options import check_whole
from gs2ci.core.errors import InputError
from gs2ci.core.progress import Progress
from gs2ci.core.whole_file import check_place
from gs2ci.evaluate.tradeoff.store import Store
from gs2ci.reconstruct.mechanisms import mechanism
from tests.tables.catalogue import TABLES, TableOptions, chosen_cases
from tests.tables.pages import Figures, collect, markdown, write_pages
from tests.tables.paired import paired, write_paired
from tests.tables.workers import complete


@dataclass(frozen=True)
class TableMade:
    """A table of figures.

    Args:
        measures: Names of the measures of which each line has a mean and a spread, as in the cells.
        figures: Mean and spread of each line of each case.
        text: The same as markdown.
        pages: The files that were written.
    """

    measures: tuple[str, ...]
    figures: list[Figures]
    text: str
    pages: list[Path]

    def records(self) -> list[dict[str, Any]]:
        """Return the lines as plain values: case, line, mean and spread by measure, count of cells, errors.

        `known` is by measure how many cells mean and spread are of: fewer than `count` if some have no such figure,
        and no entry if nobody counted.
        """
        return [
            {
                "case": one.case,
                "line": one.line,
                "mean": dict(zip(self.measures, one.means, strict=True)),
                "spread": dict(zip(self.measures, one.spreads, strict=True)),
                "known": dict(zip(self.measures, one.known, strict=False)),
                "count": one.count,
                "errors": one.errors,
            }
            for one in self.figures
        ]

    def _repr_markdown_(self) -> str:
        return self.text


def make_table(
    table: str,
    output: str | Path = "tables",
    *,
    data: str | Path | None = None,
    size: tuple[int, int] | None = None,
    cases: Sequence[str] = (),
    lines: Sequence[str] = (),
    mechanisms: bool = False,
    only: Sequence[str] = (),
    seeds: int = 3,
    processes: int = 1,
    scheduler: str = "",
    fresh: bool = False,
    command: str = "",
    progress: Progress | None = None,
) -> TableMade:
    """Make one table of figures: mean and spread over seeds, as markdown, CSV and a picture.

    Args:
        table: Which one; a wrong name lists those that exist.
        output: Folder for the pages and the finished cells, which are not computed again unless they failed.
        data: Folder of .npz measurements to use instead of simulated scenes; of rig files (.toml) for simulate.
        size: Height and width, px: of the simulated scenes, instead of 192 256; of files, the middle that is used.
            Makes tables affordable that would take hours.
        cases: Only these of the cases; if they are simulated, any scene of the library may be named.
        lines: Only these lines of the table.
        mechanisms: With the table ablation: leave out what the default is made of, one mechanism at a time, instead of
            the paper's components (the table mechanisms).
        only: Only these mechanisms, by the names of docs/mechanisms.md.
        seeds: Number of seeds.
        processes: Number of processes on this machine; more than one needs `pip install 'gs2ci[cluster]'`.
        scheduler: Address of a Dask scheduler to use instead, e.g. tcp://host:8786.
        fresh: Measure everything again.
        command: The command that repeats this, for the pages; the call if empty.
        progress: Receives the cells.

    Raises:
        InputError: A name is unknown, a file cannot be read, or no scheduler answers.
    """
    check_whole("--seeds", seeds, 1, 1000)
    check_whole("--processes", processes, 1, 1000)
    for side_px in size or ():
        check_whole("--size", side_px, 1, 100_000)
    if table not in TABLES:
        raise InputError(f"no table {table!r}", allowed=", ".join(TABLES))
    name = "mechanisms" if mechanisms and table == "ablation" else table
    if name not in TABLES or ((mechanisms or only) and name != "mechanisms"):
        raise InputError(
            f"mechanisms left out in the table {table}", allowed="python -m tests.tables ablation --mechanisms"
        )
    lines = (*lines, *(f"no {mechanism(one).name}" for one in only))
    chosen, output = TABLES[name], Path(output)
    wanted = chosen_cases(name, None if data is None else Path(data), size, cases)
    options = TableOptions(wanted, seeds, tuple(lines))
    entries = chosen.entries(options)
    check_place(output / "cells")
    with shown(progress) as display:
        display.stage(f"table {table}", len(entries))
        rows = complete(
            [entry.cell for entry in entries],
            Store(output / "cells", fresh=fresh),
            processes=processes,
            scheduler=scheduler,
            on_done=lambda done, _total: display.step(done),
        )
    figures = collect(chosen, entries, rows)
    again = command or shlex.join(["python", "-m", "tests.tables", table, "-o", str(output)])
    pages = write_pages(output, name, chosen, figures, again)
    if name == "mechanisms":
        pages.append(write_paired(output, paired(entries, rows), again))
    measures = tuple(measure.key for measure in chosen.measures)
    return TableMade(measures, figures, markdown(chosen, figures, again), pages)
