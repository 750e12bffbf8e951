"""Accuracy against time in words, as a chart with the Pareto front, as a table: a page, or a section of a run's.

Here: the section's layout. Not here: the record and its reading (`gs2ci.evaluate.tradeoff.record`), the sentences and
the trials (the rest of `gs2ci.evaluate.tradeoff`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from markupsafe import Markup

from gs2ci.evaluate.pages import pieces
from gs2ci.evaluate.pages.charts import Chart, Colour, Line
from gs2ci.evaluate.pages.frame import PageSection, page
from gs2ci.evaluate.tradeoff.record import HEADINGS, TITLES, Measure, TradeoffRecord, Tried

LEAD: Final = (
    "Presets, and the standard with one setting changed at a time, tried on this measurement by gs2ci tradeoff; "
    "seconds run from the measurement to its views."
)
# Those of the ladder of presets; all others change one setting.
_LADDER: Final = "preset"


@dataclass(frozen=True)
class _Point:
    """A trial in the chart: its number in the table, and its quality."""

    number: int
    trial: Tried
    value: float


def tradeoff_page(record: TradeoffRecord) -> str:
    """Build a page of it alone."""
    return page(record.name, [tradeoff_section(record)], eyebrow="gs2ci tradeoff")


def tradeoff_section(record: TradeoffRecord) -> PageSection:
    """Build the section."""
    said = pieces.sentences(record.sentences, empty="Nothing was tried with success.")
    shown = _chart(record) + _exposures(record) + said + _table(record) + _origin(record)
    return PageSection("What accuracy costs", shown, LEAD)


def _chart(record: TradeoffRecord) -> Markup:
    measure = record.measure
    if measure is None:
        return Markup()
    points = [
        _Point(number, trial, value)
        for number, trial in enumerate(record.trials, 1)
        if (value := getattr(trial, measure)) is not None
    ]
    front = sorted((point.trial.seconds, point.value) for point in points if point.trial.unbeaten)
    lines = [
        Line("no other is both quicker and better", *_stairs(front), "muted", dots=False),
        _cloud("presets", [point for point in points if point.trial.knob == _LADDER], "accent"),
        _cloud("one setting changed", [point for point in points if point.trial.knob != _LADDER], "truth"),
    ]
    lines = [line for line in lines if line.x]
    if not lines:
        return Markup()
    drawn = Chart(lines, "seconds", TITLES[measure], _in_words(front, measure), x_log=True)
    return pieces.chart(
        drawn, caption="Left is quicker, up is better. A number is the trial's row in the table.", tabled=False
    )


def _exposures(record: TradeoffRecord) -> Markup:
    """Return quality against the number of exposures together, if several numbers were tried."""
    measure = record.measure
    tried = (
        [] if measure is None else [one for one in record.trials if one.exposures and getattr(one, measure) is not None]
    )
    tried.sort(key=lambda one: one.exposures or 0)
    if measure is None or len(tried) < 2:
        return Markup()
    numbers, values = [float(one.exposures or 0) for one in tried], [getattr(one, measure) for one in tried]
    names = [f"{one.seconds:.0f} s" for one in tried]
    line = Line("exposures together", numbers, values, "accent", names=names)
    words = f"{TITLES[measure]} against exposures: {values[0]:.2f} dB with {numbers[0]:g} to {values[-1]:.2f} dB with "
    drawn = Chart([line], "exposures together", TITLES[measure], f"{words}{numbers[-1]:g}", x_log=True)
    return pieces.chart(drawn, caption="Beside the points: seconds of computing.", tabled=False)


def _cloud(label: str, points: Sequence[_Point], colour: Colour) -> Line:
    """Return trials as dots; only those of the front have numbers beside them, so that these have room."""
    return Line(
        label,
        [point.trial.seconds for point in points],
        [point.value for point in points],
        colour,
        joined=False,
        names=[f"{point.number}" if point.trial.unbeaten else "" for point in points],
        titles=[f"{point.number}, {point.trial.trial}" for point in points],
    )


def _stairs(front: Sequence[tuple[float, float]]) -> tuple[list[float], list[float]]:
    """Return the corners of a staircase: the quality stays constant up to the next trial of the front."""
    corners = [*front[:1]]
    for (_, before), (seconds, after) in pairwise(front):
        corners += [(seconds, before), (seconds, after)]
    return [corner[0] for corner in corners], [corner[1] for corner in corners]


def _in_words(front: Sequence[tuple[float, float]], measure: Measure) -> str:
    ends = [f"{value:.2f} dB after {seconds:.1f} s" for seconds, value in (*front[:1], *front[-1:])]
    return f"{TITLES[measure]} against seconds: {' to '.join(ends)}"


def _table(record: TradeoffRecord) -> Markup:
    if not record.trials:
        return Markup()
    rows = [[number, trial.trial, *trial.cells] for number, trial in enumerate(record.trials, 1)]
    marked = {(row, 1) for row, trial in enumerate(record.trials) if trial.unbeaten}
    return pieces.table(("№", *HEADINGS), rows, caption="Bold: no other is both quicker and better.", marked=marked)


def _origin(record: TradeoffRecord) -> Markup:
    rows = [
        ("command", record.command or None),
        ("processor", record.machine.processor),
        ("usable cores", record.machine.usable_cores),
        ("gs2ci", record.versions.get("gs2ci")),
    ]
    return pieces.facts([(name, value) for name, value in rows if value is not None])
