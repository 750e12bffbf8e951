"""A finished table as one self-contained HTML page, in the frame that run pages have.

Here: the text of the page. Not here: its components (`gs2ci.evaluate.pages`); means, markdown, CSV and picture
(`pages`).
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

from markupsafe import Markup

from gs2ci.core.whole_file import write_whole
from gs2ci.evaluate.environment import machine, versions
from gs2ci.evaluate.pages import pieces
from gs2ci.evaluate.pages.charts import Spread
from gs2ci.evaluate.pages.frame import PageSection, page
from gs2ci.evaluate.pages.pieces import FigureOfMerit, Tone
from gs2ci.evaluate.wording import flat_rows, spoken_rows
from gs2ci.tables.catalogue import Table
from gs2ci.tables.columns import Measure
from gs2ci.tables.pages import Figures, best_of, partly_known, shown

Cases = Mapping[str, Sequence[Figures]]


def write_html_page(folder: Path, name: str, table: Table, figures: Sequence[Figures], command: str) -> Path:
    """Write `name.html`; return its path.

    Raises:
        StorageError: The disk refuses.
    """
    return write_whole(folder / f"{name}.html", html_page(table, figures, command), parents=True)


def html_page(table: Table, figures: Sequence[Figures], command: str) -> str:
    """Lay a table out as a page: a summary, then a table and a chart for each case."""
    cases = {case: [one for one in figures if one.case == case] for case in dict.fromkeys(one.case for one in figures)}
    sections = [
        PageSection(case, _table(table, lines) + _chart(table.measures[0], lines)) for case, lines in cases.items()
    ]
    errors = [f"{one.case}, {one.line}: {error}" for one in figures for error in one.errors]
    if errors:
        sections.append(PageSection("What failed", pieces.sentences(errors, empty="")))
    fewer = [f"{one.case}, {one.line}: {said}" for one in figures if (said := partly_known(table, one))]
    if fewer:
        sections.append(PageSection("Means of fewer cells", pieces.sentences(fewer, empty="")))
    origin = pieces.facts([("command", command), *spoken_rows(machine()), *flat_rows(versions())])
    sections.append(PageSection("How it was made", origin))
    return page(table.title, sections, masthead=_masthead(table, cases), eyebrow=f"{table.title} · gs2ci tables")


def _masthead(table: Table, cases: Cases) -> Markup:
    every = [one for lines in cases.values() for one in lines]
    done = sum(one.count for one in every)
    tone: Tone = "poor" if not done else "mixed" if any(one.errors for one in every) else "good"
    word = {"good": "Complete", "mixed": "With gaps", "poor": "Nothing succeeded"}[tone]
    measure = table.measures[0]
    best = {case: found for case, lines in cases.items() if (found := _best_line(measure, lines)) is not None}
    sentences = [f"{case}: {one.line}, {shown(measure, one, 0)} ({measure.title})." for case, one in best.items()]
    figures = [
        FigureOfMerit(f"{len(cases)}", "Cases"),
        FigureOfMerit(f"{len({one.line for one in every})}", "Lines"),
        FigureOfMerit(f"{done}", "Cells", "succeeded"),
    ]
    return pieces.masthead(_headline(table, best), [table.about, *sentences], figures, tone, word)


def _headline(table: Table, best: Mapping[str, Figures]) -> str:
    """State which line is best in the most cases, by the table's first measure."""
    winners = [one.line for one in best.values()]
    if not winners:
        return table.title
    often = max(dict.fromkeys(winners), key=winners.count)
    many = f"in {winners.count(often)} of {len(winners)} cases" if len(winners) > 1 else f"for {next(iter(best))}"
    return f"{table.title}: {often} has the best {table.measures[0].title.partition(',')[0]} {many}"


def _best_line(measure: Measure, lines: Sequence[Figures]) -> Figures | None:
    best = best_of(measure, [one.means[0] for one in lines])
    return None if best is None else next(one for one in lines if one.means[0] == best)


def _table(table: Table, lines: Sequence[Figures]) -> Markup:
    best = [best_of(measure, [one.means[k] for one in lines]) for k, measure in enumerate(table.measures)]
    rows, marked = [], set()
    for row, one in enumerate(lines):
        rows.append([one.line, *(shown(measure, one, k) for k, measure in enumerate(table.measures)), one.count])
        marked |= {(row, k + 1) for k, value in enumerate(best) if value is not None and one.means[k] == value}
    headings = ["", *(measure.title for measure in table.measures), "cells"]
    return pieces.table(headings, rows, caption="Mean ± standard deviation over seeds.", marked=marked)


def _chart(measure: Measure, lines: Sequence[Figures]) -> Markup:
    rows = [
        Spread(one.line, one.means[0], one.spreads[0] or 0.0, shown(measure, one, 0))
        for one in lines
        if one.means[0] is not None
    ]
    return pieces.spreads(rows, measure.title) if len(rows) > 1 else Markup()
