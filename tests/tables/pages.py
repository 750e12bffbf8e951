"""A finished table as markdown, CSV and a picture.

Here: means and spreads, and the three files. Not here: the computation of the cells (`works`), the HTML page
(`html_page`).
"""

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean, stdev

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from gs2ci.core.whole_file import write_whole
from gs2ci.evaluate.environment import machine, versions
from gs2ci.evaluate.tradeoff.store import Row
from tests.tables.catalogue import Table, TableEntry
from tests.tables.columns import Measure


@dataclass(frozen=True)
class Figures:
    """One line of one case: a mean and a spread for each measure.

    Args:
        case: Name of the measurement.
        line: Name of the variant.
        means: Per measure; None if no cell has a figure.
        spreads: Sample standard deviation over the seeds; None for less than two.
        count: Cells that succeeded. A cell with an error did not, nor did a result whose depth order is reversed
            (`order`), however good its views are.
        errors: The reasons of the other cells.
        known: Per measure: how many of the cells that succeeded have a figure; () if nobody counted.
    """

    case: str
    line: str
    means: tuple[float | None, ...]
    spreads: tuple[float | None, ...]
    count: int
    errors: tuple[str, ...]
    known: tuple[int, ...] = ()


def collect(table: Table, entries: Sequence[TableEntry], rows: Sequence[Row]) -> list[Figures]:
    """Gather the rows of each line of each case, in the order of the entries."""
    together: dict[tuple[str, str], list[Row]] = {}
    for entry, row in zip(entries, rows, strict=True):
        together.setdefault((entry.case, entry.line), []).append(row)
    return [_figures(table, case, line, cells) for (case, line), cells in together.items()]


def _figures(table: Table, case: str, line: str, cells: list[Row]) -> Figures:
    failed = [row.get("error") or row.get("failure") for row in cells]
    good = [row for row, why in zip(cells, failed, strict=True) if not why]
    values = [[float(row[m.key]) for row in good if row.get(m.key) is not None] for m in table.measures]
    return Figures(
        case,
        line,
        tuple(mean(known) if known else None for known in values),
        tuple(stdev(known) if len(known) > 1 else None for known in values),
        len(good),
        tuple(dict.fromkeys(str(why) for why in failed if why)),
        tuple(len(known) for known in values),
    )


def partly_known(table: Table, one: Figures) -> str:
    """Name the columns whose mean is of some of the line's cells only: it may not be compared with the others."""
    pairs = zip(table.measures, one.known, strict=False)
    fewer = [f"{measure.title}: {known} of {one.count}" for measure, known in pairs if 0 < known < one.count]
    return f"means of fewer cells ({'; '.join(fewer)})" if fewer else ""


def write_pages(folder: Path, name: str, table: Table, figures: Sequence[Figures], command: str) -> list[Path]:
    """Write `name.md`, `name.csv` and `name.png`, each whole or not at all; return their paths.

    Raises:
        StorageError: The disk refuses.
    """
    picture = io.BytesIO()
    draw(table, figures).savefig(picture, format="png", dpi=150)
    made: dict[str, bytes | str] = {
        "md": markdown(table, figures, command),
        "csv": as_csv(table, figures),
        "png": picture.getvalue(),
    }
    return [write_whole(folder / f"{name}.{ending}", content, parents=True) for ending, content in made.items()]


def markdown(table: Table, figures: Sequence[Figures], command: str) -> str:
    """Lay the figures out, a table per case; the best of each column is bold."""
    parts = [
        f"# {table.title}",
        "",
        table.about,
        "",
        f"`{command}`, {_machine_sentence()}. Mean ± standard deviation over seeds.",
        "",
    ]
    for case in dict.fromkeys(one.case for one in figures):
        lines = [one for one in figures if one.case == case]
        best = [best_of(measure, [one.means[k] for one in lines]) for k, measure in enumerate(table.measures)]
        parts += [f"## {case}", "", "| | " + " | ".join(measure.title for measure in table.measures) + " |"]
        parts.append("|---|" + "---:|" * len(table.measures))
        for one in lines:
            cells = [shown(measure, one, k, best[k]) for k, measure in enumerate(table.measures)]
            parts.append(f"| {one.line} | " + " | ".join(cells) + " |")
        said = [f"- {one.line}: {why}" for one in lines for why in (*one.errors, partly_known(table, one)) if why]
        parts += ["", *said, ""] if said else [""]
    return "\n".join(parts).rstrip() + "\n"


def _machine_sentence() -> str:
    return f"{machine().processor}, gs2ci {versions()['gs2ci']}"


def best_of(measure: Measure, means: Sequence[float | None]) -> float | None:
    """Return the best of a column's means; None with less than two."""
    known = [value for value in means if value is not None]
    if len(known) < 2:
        return None
    return max(known) if measure.more_is_better else min(known)


def shown(measure: Measure, one: Figures, k: int, best: float | None = None) -> str:
    """Return the k-th measure of a line as it stands in a table: mean ± spread, bold in markdown if it is the best."""
    value, spread = one.means[k], one.spreads[k]
    if value is None:
        return "–"
    text = f"{value:.{measure.digits}f}"
    if value == best:
        text = f"**{text}**"
    return text if spread is None else f"{text} ± {spread:.{measure.digits}f}"


def as_csv(table: Table, figures: Sequence[Figures]) -> str:
    """Write the figures with full digits, one row for each line of each case.

    Per measure: the mean, `_sd` the sample standard deviation, `_n` how many cells both are of, empty if nobody
    counted.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    columns = [f"{measure.key}{ending}" for measure in table.measures for ending in ("", "_sd", "_n")]
    writer.writerow(["case", "line", "cells", *columns, "errors"])
    for one in figures:
        known = one.known or (None,) * len(one.means)
        told = [value for measure in zip(one.means, one.spreads, known, strict=True) for value in measure]
        writer.writerow([one.case, one.line, one.count, *told, "; ".join(one.errors)])
    return text.getvalue()


def draw(table: Table, figures: Sequence[Figures]) -> Figure:
    """Plot the first measure of every line with its spread: a panel per case, or a curve per case if it has an axis."""
    if table.axis:
        return _draw_curves(table, figures)
    measure = table.measures[0]
    cases = list(dict.fromkeys(one.case for one in figures))
    most = max(sum(one.case == case for one in figures) for case in cases)
    columns = min(2, len(cases))
    rows = math.ceil(len(cases) / columns)
    figure = Figure(figsize=(5.2 * columns, (0.9 + 0.28 * most) * rows), layout="constrained")
    for k, case in enumerate(cases):
        axes = figure.add_subplot(rows, columns, k + 1)
        lines = [one for one in figures if one.case == case and one.means[0] is not None]
        places = range(len(lines))
        axes.errorbar(
            [one.means[0] or 0.0 for one in lines], places, xerr=[one.spreads[0] or 0.0 for one in lines],
            fmt="o", color="#1f6f8b", ecolor="#9bbcc7", capsize=3,
        )  # fmt: skip
        axes.set_yticks(places, [one.line for one in lines])
        axes.set_ylim(max(len(lines), 1) - 0.5, -0.5)  # the first line at the top, and no point clipped by the frame
        axes.set_title(case, loc="left", fontsize=10)
        axes.set_xlabel(measure.title)
        axes.grid(axis="x", color="#e4e4e4")
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _draw_curves(table: Table, figures: Sequence[Figures]) -> Figure:
    """Plot a curve per case over the lines' numbers; a line without a number is a dash at the left."""
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.add_subplot()
    cases = list(dict.fromkeys(one.case for one in figures))
    colours = colormaps["viridis"](np.linspace(0, 0.95, len(cases)))
    numbers = [number for one in figures if (number := _number(one.line)) is not None]
    names = dict.fromkeys(one.line for one in figures if _number(one.line) is None)
    others = f" (dashes: {', '.join(names)})" if names else ""
    left = 0.6 * min(numbers, default=1.0)
    for case, colour in zip(cases, colours, strict=True):
        known = [(_number(one.line), one.means[0]) for one in figures if one.case == case and one.means[0]]
        curve = [(number, value) for number, value in known if number is not None]
        axes.plot([number for number, _ in curve], [value for _, value in curve], "o-", color=colour, ms=3, label=case)
        dashes = [value for number, value in known if number is None]
        axes.plot([left] * len(dashes), dashes, "_", color=colour, markersize=12)
    # Matplotlib cannot scale a logarithmic axis without values, which happens if every cell failed.
    scale = "log" if any(one.means[0] for one in figures) else "linear"
    axes.set(xscale=scale, yscale=scale, xlabel=table.axis, ylabel=table.measures[0].title + others)
    axes.grid(color="#e4e4e4")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=7, ncols=2)
    return figure


def _number(line: str) -> float | None:
    """Return the number that a line begins with."""
    try:
        return float(line.split(maxsplit=1)[0])
    except ValueError:
        return None
