"""`gs2ci tradeoff`: what accuracy costs in time, for one shot on this machine.

Here: the arguments, and the order price → try → say. Not here: any of the three (`gs2ci.evaluate.tradeoff`), keeping
what is finished (`gs2ci.tables`).
"""

import math
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.markdown import Markdown

from gs2ci.commands.display import open_display
from gs2ci.commands.options import check_seed
from gs2ci.core.durations import parse_duration_s, spoken_duration
from gs2ci.core.errors import InputError
from gs2ci.core.whole_file import check_place

if TYPE_CHECKING:
    from gs2ci.evaluate.tradeoff.trials import TradeoffTrial
    from gs2ci.tables.cells import Cell


def run(
    shot: Annotated[Path, tyro.conf.Positional],
    /,
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("tradeoff"),
    *,
    index: int = 0,
    knobs: tuple[str, ...] = (),
    most: str = "15min",
    seed: int = 42,
    report: Path | None = None,
    fresh: bool = False,
) -> list[Path]:
    """Try presets and settings on one measurement, and say what the next decibel costs.

    Every trial is judged by the truth where the shot holds it, and by pixels of the measurement that no trial sees.
    Finished trials are kept in `<output>/cells`: an interrupted command goes on where it was left. Seconds are only
    worth reading on a quiet machine.

    Args:
        shot: A shot file, as `gs2ci import` and `gs2ci capture` write them.
        output: Folder for CSV, picture, section and the finished trials.
        index: Which shot of the file.
        knobs: What to vary, one thing at a time: preset (decode only, draft, standard, fine, paper), resolution,
            fits, iterations, population, start, "decode steps", "first look", "depth planes", windows, "list reuse",
            precision;
            all of them when not given.
        most: Leave out what is expected to take longer than this, by costs measured on the shot beforehand.
        seed: Of every random draw.
        report: A run folder of the same shot: its report.html gets a section on what accuracy costs, and keeps it
            when `gs2ci report` builds it again.
        fresh: Try everything again.

    Returns:
        The pages; last the run's, if there is one.

    Raises:
        Gs2ciError: The file or a value cannot be used.
    """
    check_seed(seed)
    most_s = parse_duration_s(most)
    from gs2ci.core.storage import read_shot

    measured = read_shot(shot, index)
    from gs2ci.evaluate.pages.run_evidence import check_same_shot
    from gs2ci.evaluate.pages.run_page import write_run_page
    from gs2ci.evaluate.tradeoff.pages import Tradeoff, markdown, record_of, write_pages
    from gs2ci.evaluate.tradeoff.record import write_record
    from gs2ci.evaluate.tradeoff.trials import KNOBS, chosen_trials, predicted_seconds
    from gs2ci.reconstruct.budget.costs import probe
    from gs2ci.tables.store import Store
    from gs2ci.tables.workers import complete

    trials = chosen_trials(knobs or KNOBS)
    check_place(output / "cells")
    if report is not None:
        check_same_shot(report, measured)
    with open_display() as display:
        display.stage("measuring this machine")
        model = probe(measured)
        display.finish()
        prices = {trial.name: predicted_seconds(trial, model) for trial in trials}
        wanted = [trial for trial in trials if prices[trial.name] <= most_s]
        if not wanted:
            least_s = math.ceil(100 * min(prices.values())) / 100
            raise InputError(f"nothing can be tried in {most}", allowed=f"{least_s:g} s or more", remedy="raise --most")
        in_all = spoken_duration(sum(prices[trial.name] for trial in wanted))
        count = f"{len(wanted)} trial{'s' if len(wanted) > 1 else ''}"
        display.say(f"{count}, about {in_all} in all; an interruption keeps those that are done.")
        display.stage("trials", len(wanted))
        rows = complete(
            [_cell(shot, index, trial, seed) for trial in wanted],
            Store(output / "cells", fresh=fresh),
            heard=lambda done, _total: display.step(done),
        )
    rows = [{"trial": trial.name, "knob": trial.knob, **row} for trial, row in zip(wanted, rows, strict=True)]
    left_out = {name: seconds for name, seconds in prices.items() if seconds > most_s}
    found = Tradeoff(measured.name, rows, left_out, shlex.join(["gs2ci", *sys.argv[1:]]))
    pages = write_pages(output, found)
    if report is not None:
        write_record(report, record_of(found))
        pages.append(write_run_page(report))
    console = Console()
    console.print(Markdown(markdown(found)))
    for page in pages:
        console.print(str(page), soft_wrap=True)
    return pages


def _cell(shot: Path, index: int, trial: "TradeoffTrial", seed: int) -> "Cell":
    from gs2ci.evaluate.tradeoff.trials import run_trial
    from gs2ci.tables.cells import Cell

    file = str(shot.resolve())
    arguments = {"file": file, "index": index, "trial": trial.name, "seed": seed}
    return Cell(run_trial, arguments, (file,))
