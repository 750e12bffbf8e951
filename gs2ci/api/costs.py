"""Accuracy against time, for one shot and in tables: `tradeoff`, `make_table`.

Here: the order of estimating costs, running trials and reporting, and of cells, rows and pages. Not here: any of these
(`gs2ci.evaluate.tradeoff`, `gs2ci.tables`).
"""

import hashlib
import math
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gs2ci.api.display import shown
from gs2ci.api.options import check_seed, check_whole
from gs2ci.core.durations import parse_duration_s, spoken_duration
from gs2ci.core.errors import InputError
from gs2ci.core.json_text import as_json
from gs2ci.core.progress import Progress
from gs2ci.core.records import Shot
from gs2ci.core.whole_file import check_place

if TYPE_CHECKING:
    from gs2ci.evaluate.tradeoff.pages import Tradeoff
    from gs2ci.evaluate.tradeoff.trials import TradeoffTrial
    from gs2ci.tables.cells import Cell
    from gs2ci.tables.pages import Figures


@dataclass(frozen=True)
class TradeoffFound:
    """Accuracy against time for one shot.

    Args:
        found: The trials' figures.
        text: The same as markdown.
        pages: The files that were written; last the run's page, if there is one.
    """

    found: "Tradeoff"
    text: str
    pages: list[Path]

    def _repr_markdown_(self) -> str:
        return self.text


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
    figures: "list[Figures]"
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


def tradeoff(
    shot: Shot | str | Path,
    output: str | Path = "tradeoff",
    *,
    index: int = 0,
    knobs: Sequence[str] = (),
    most: str = "15min",
    seed: int = 42,
    report: str | Path | None = None,
    fresh: bool = False,
    command: str = "",
    progress: Progress | None = None,
) -> TradeoffFound:
    """Try presets and settings on one measurement, and report the seconds per decibel of each step.

    Finished trials are kept in `<output>/cells`: a repeated call continues where an interrupted one stopped, and tries
    failed trials again.

    Args:
        shot: A shot file; or a shot, which is saved in `<output>/cells` for trials in other processes, under a name
            that its content determines.
        output: Folder for CSV, picture, section and the finished trials.
        index: Which shot of the file.
        knobs: What to vary, one thing at a time: preset (decode only, draft, standard, fine, paper), resolution,
            fits, iterations, population, start, "decode steps", "first look", "depth planes", windows, "list reuse",
            precision; by default all of them.
        most: Skip trials that are expected to take longer than this, by costs measured on the shot in advance.
        seed: Seed of every random draw.
        report: A run folder of the same shot: its report.html gets a section on what accuracy costs, and keeps it
            when `gs2ci report` rebuilds it.
        fresh: Repeat finished trials.
        command: The command that repeats this, for the pages.
        progress: Receives the trials.

    Raises:
        InputError: A value cannot be used, no trial fits into the time, or every one fails.
        StorageError: A file cannot be read or written.

    Example:
        >>> found = gs2ci.tradeoff("shot.h5", "costs", knobs=("fits",), most="0.001s", progress=gs2ci.Silent())
        Traceback (most recent call last):
        gs2ci.core.errors.InputError: nothing can be tried in 0.001s; ...
    """
    check_seed(seed)
    most_s = parse_duration_s(most)
    # Read before imports that take seconds: a missing file is reported at once.
    from gs2ci.core.storage import read_shot

    measured = shot.check() if isinstance(shot, Shot) else read_shot(Path(shot), index)
    from gs2ci.evaluate.pages.run_evidence import check_same_shot
    from gs2ci.evaluate.pages.run_page import write_run_page
    from gs2ci.evaluate.tradeoff import costs
    from gs2ci.evaluate.tradeoff.pages import Tradeoff, markdown, record_of, write_pages
    from gs2ci.evaluate.tradeoff.record import write_record
    from gs2ci.evaluate.tradeoff.trials import KNOBS, chosen_trials, predicted_seconds
    from gs2ci.tables.store import Store
    from gs2ci.tables.workers import complete

    output = Path(output)
    trials = chosen_trials(tuple(knobs) or KNOBS)
    file = None if isinstance(shot, Shot) else Path(shot)
    check_place(output / "cells")
    if report is not None:
        check_same_shot(Path(report), measured)
    with shown(progress) as display:
        display.stage("measuring this machine")
        model = costs.probe(measured)
        display.finish()
        prices = {trial.name: predicted_seconds(trial, model) for trial in trials}
        wanted = [trial for trial in trials if prices[trial.name] <= most_s]
        if not wanted:
            least_s = math.ceil(100 * min(prices.values())) / 100
            raise InputError(f"nothing can be tried in {most}", allowed=f"{least_s:g} s or more", remedy="raise --most")
        in_all = spoken_duration(sum(prices[trial.name] for trial in wanted))
        count = f"{len(wanted)} trial{'s' if len(wanted) > 1 else ''}"
        display.say(f"{count}, about {in_all} in all; an interruption keeps those that are done.")
        kept, row = (_kept(output / "cells", measured), 0) if file is None else (file, index)
        display.stage("trials", len(wanted))
        rows = complete(
            [_cell(kept, row, trial, seed) for trial in wanted],
            Store(output / "cells", fresh=fresh),
            on_done=lambda done, _total: display.step(done),
        )
    if all("error" in row for row in rows):
        raise InputError(f"every trial failed, {wanted[0].name!r} because of: {rows[0]['error']}")
    rows = [{"trial": trial.name, "knob": trial.knob, **row} for trial, row in zip(wanted, rows, strict=True)]
    left_out = {name: seconds for name, seconds in prices.items() if seconds > most_s}
    found = Tradeoff(measured.name, rows, left_out, command)
    pages = write_pages(output, found)
    if report is not None:
        write_record(Path(report), record_of(found))
        pages.append(write_run_page(Path(report)))
    return TradeoffFound(found, markdown(found), pages)


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
    """Make one table of figures: mean and spread over seeds, as markdown, CSV, a picture and an HTML page.

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

    Example:
        >>> try:
        ...     gs2ci.make_table("none")
        ... except gs2ci.InputError as error:
        ...     "ablation" in error.allowed
        True
    """
    check_whole("--seeds", seeds, 1, 1000)
    check_whole("--processes", processes, 1, 1000)
    for side_px in size or ():
        check_whole("--size", side_px, 1, 100_000)
    from gs2ci.reconstruct.mechanisms import mechanism
    from gs2ci.tables.catalogue import TABLES, TableOptions, chosen_cases
    from gs2ci.tables.html_page import write_html_page
    from gs2ci.tables.pages import collect, markdown, write_pages
    from gs2ci.tables.paired import paired, write_paired
    from gs2ci.tables.store import Store
    from gs2ci.tables.workers import complete

    if table not in TABLES:
        raise InputError(f"no table {table!r}", allowed=", ".join(TABLES))
    name = "mechanisms" if mechanisms and table == "ablation" else table
    if name not in TABLES or ((mechanisms or only) and name != "mechanisms"):
        raise InputError(f"mechanisms left out in the table {table}", allowed="gs2ci tables ablation --mechanisms")
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
    again = command or shlex.join(["gs2ci", "tables", table, "-o", str(output)])
    pages = write_pages(output, name, chosen, figures, again)
    pages.append(write_html_page(output, name, chosen, figures, again))
    if name == "mechanisms":
        pages.append(write_paired(output, paired(entries, rows), again))
    measures = tuple(measure.key for measure in chosen.measures)
    return TableMade(measures, figures, markdown(chosen, figures, again), pages)


def _kept(cells: Path, shot: Shot) -> Path:
    """Return the file of a shot among the finished trials; it is written if it is not there.

    Another shot has another name, and the same shot the same file, because the hash of a trial includes the file's.
    """
    from gs2ci.core.storage import write_shots

    digest = hashlib.sha256()
    for part in (shot, shot.truth):
        for name, value in vars(part).items():
            if isinstance(value, np.ndarray):
                digest.update(f"{name} {value.shape}".encode())
                digest.update(value.tobytes())
            elif name != "truth":
                digest.update(as_json([name, value]).encode())
    path = cells / f"shot-{digest.hexdigest()[:20]}.h5"
    cells.mkdir(parents=True, exist_ok=True)
    return path if path.is_file() else write_shots(path, [shot])


def _cell(shot: Path, index: int, trial: "TradeoffTrial", seed: int) -> "Cell":
    from gs2ci.evaluate.tradeoff.trials import run_trial
    from gs2ci.tables.cells import Cell

    file = str(shot.resolve())
    arguments = {"file": file, "index": index, "trial": trial.name, "seed": seed}
    return Cell(run_trial, arguments, (file,))
