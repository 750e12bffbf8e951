"""Charts as SVG that use the page's colours and fonts, also in dark mode and in print.

Here: lines and dots over linear or logarithmic axes, bars of parts. Not here: their place on the page (`pieces.py`).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from markupsafe import Markup

from gs2ci.core.errors import InputError
from gs2ci.evaluate.pages.frame import environment
from gs2ci.evaluate.wording import describe_number

Colour = Literal["accent", "truth", "muted", "third", "fourth", "fifth"]

# Margin of an axis as a share of the data's height, or of their value if they are constant.
MARGIN: Final = 0.08
LEAST_SPAN: Final = 1e-3
# Smallest distance between ticks, in the drawing's units (a character is about 6 wide).
TICK_ROOM_X: Final = 48
TICK_ROOM_Y: Final = 34


@dataclass(frozen=True)
class Line:
    """One curve or cloud of points.

    Args:
        label: For the legend.
        x: [K].
        y: [K].
        colour: One of the page's colours.
        joined: Draw the line between the points.
        dots: Draw the points.
        dashed: Dash the line.
        names: Names of the points, written beside them; empty, or [K].
        titles: Tooltips of the points, [K]; if empty, the names are used, or the label.
    """

    label: str
    x: Sequence[float]
    y: Sequence[float]
    colour: Colour = "accent"
    joined: bool = True
    dots: bool = True
    dashed: bool = False
    names: Sequence[str] = ()
    titles: Sequence[str] = ()

    @property
    def style(self) -> Literal["line", "dashed", "dots"]:
        """Get its style in the legend."""
        return "dots" if not self.joined else "dashed" if self.dashed else "line"


@dataclass(frozen=True)
class Chart:
    """A chart of lines.

    Args:
        lines: At least one, with at least one finite point in all.
        x_label: Name and unit.
        y_label: Name and unit.
        alt: What the chart shows, in a sentence.
        x_log: Whether the axis is logarithmic; then only points with x > 0 are drawn.
        y_log: The same for y.
        levels: Named values of y to compare with, drawn as dashed lines.
    """

    lines: Sequence[Line]
    x_label: str
    y_label: str
    alt: str
    x_log: bool = False
    y_log: bool = False
    levels: Sequence[tuple[str, float]] = ()


@dataclass(frozen=True)
class Bar:
    """A part of a whole: its name, its size >= 0, its label, its colour."""

    label: str
    size: float
    text: str
    colour: Colour = "accent"


@dataclass(frozen=True)
class _Axis:
    """An axis: from data to the drawing's units, and its ticks."""

    low: float
    high: float
    log: bool
    start: float
    end: float

    def place(self, value: float) -> float:
        low, high, value = (math.log10(v) if self.log else v for v in (self.low, self.high, value))
        return round(self.start + (self.end - self.start) * (value - low) / (high - low), 2)

    def ticks(self, room: float) -> list[tuple[float, str]]:
        most = max(2, int(abs(self.end - self.start) / room))
        values = _log_ticks(self.low, self.high, most) if self.log else _even_ticks(self.low, self.high, most)
        digits = 2 + max(0, math.ceil(-math.log10((self.high - self.low) / max(abs(self.high), 1e-300))))
        return [(self.place(value), describe_number(value, digits)) for value in values]


def chart_svg(chart: Chart, width: int, height: int) -> Markup:
    """Draw a chart for a width in CSS pixels.

    Raises:
        InputError: There is no point to draw.
    """
    points = [[p for p in zip(line.x, line.y, strict=True) if _drawable(p, chart)] for line in chart.lines]
    every = [p for line in points for p in line]
    if not every:
        raise InputError("a chart without a point", allowed="at least one finite point (above 0 on logarithmic axes)")
    levels = [(name, value) for name, value in chart.levels if _drawable((1.0, value), chart)]
    left, right, top, bottom = 52, width - 14, 26, height - 42
    x = _axis([p[0] for p in every], chart.x_log, left, right)
    y = _axis([p[1] for p in every] + [value for _, value in levels], chart.y_log, bottom, top)
    drawn = [
        {
            "colour": line.colour,
            "dashed": line.dashed,
            "path": _path([(x.place(a), y.place(b)) for a, b in kept]) if line.joined and len(kept) > 1 else "",
            "dots": _dots(line, kept, x, y, chart) if line.dots or len(kept) == 1 else [],
        }
        for line, kept in zip(chart.lines, points, strict=True)
    ]
    return _render(
        "chart",
        chart=chart,
        width=width,
        height=height,
        box=(left, top, right, bottom),
        x_ticks=x.ticks(TICK_ROOM_X),
        y_ticks=y.ticks(TICK_ROOM_Y),
        levels=[(name, y.place(value)) for name, value in levels],
        drawn=drawn,
    )


def chart_table(chart: Chart) -> tuple[list[str], list[list[Any]]]:
    """List a chart's numbers: headings and rows."""
    many = len(chart.lines) > 1
    headings = [*(["line"] if many else []), chart.x_label, chart.y_label]
    rows = [
        [*([line.label] if many else []), describe_number(a, 5), describe_number(b, 5)]
        for line in chart.lines
        for a, b in zip(line.x, line.y, strict=True)
    ]
    return headings, rows


def bars_svg(parts: Sequence[Bar], unit: str) -> Markup:
    """Draw the parts of a whole as one bar; parts of size 0 are not drawn."""
    total = sum(part.size for part in parts)
    drawn, at = [], 0.0
    for part in parts:
        share = 1000 * part.size / total if total > 0 else 0.0
        if share > 0:
            drawn.append((round(at, 2), round(max(share - 3, 1), 2), part))
        at += share
    return _render("bars", drawn=drawn, unit=unit, alt=", ".join(f"{part.label} {part.text}" for part in parts))


def _render(name: str, **values: Any) -> Markup:
    return getattr(environment().get_template("charts.html").module, name)(**values)


def _drawable(point: tuple[float, float], chart: Chart) -> bool:
    logs = (chart.x_log, chart.y_log)
    return all(math.isfinite(value) and (value > 0 or not log) for value, log in zip(point, logs, strict=True))


def _axis(values: Sequence[float], log: bool, start: float, end: float) -> _Axis:
    """Fit an axis to values, with room on both sides, also if all are the same."""
    if log:
        low, high = min(values), max(values)
        margin = max((high / low) ** MARGIN, 1.05)
        return _Axis(low / margin, high * margin, log, start, end)
    low, high = min(values), max(values)
    margin = max(MARGIN * (high - low), LEAST_SPAN * max(abs(low), abs(high)), 1e-12)
    return _Axis(low - margin, high + margin, log, start, end)


def _even_ticks(low: float, high: float, most: int) -> list[float]:
    raw = (high - low) / most
    power = 10 ** math.floor(math.log10(raw))
    step = next(power * m for m in (1, 2, 5, 10) if power * m >= raw)
    first = math.ceil(low / step)
    # Multiples of the step, rounded to its digits: otherwise a label could read 0.30000000000000004.
    digits = max(0, -math.floor(math.log10(step)) + 1)
    return [round(step * i, digits) for i in range(first, math.floor(high / step) + 1)]


def _log_ticks(low: float, high: float, most: int) -> list[float]:
    for subs in ((1, 2, 3, 4, 5, 6, 7, 8, 9), (1, 2, 5), (1, 3), (1,)):
        decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
        found = [sub * 10.0**decade for decade in decades for sub in subs]
        found = [value for value in found if low <= value <= high]
        if len(found) <= most:
            break
    found = found[:: max(1, math.ceil(len(found) / most))]
    return found if len(found) >= 2 else _even_ticks(low, high, most)


def _path(points: Sequence[tuple[float, float]]) -> str:
    return "M" + "L".join(f"{x:g},{y:g}" for x, y in points)


def _dots(
    line: Line, kept: Sequence[tuple[float, float]], x: _Axis, y: _Axis, chart: Chart
) -> list[tuple[float, float, str, str]]:
    """Place dots: x, y, the name beside it, the tooltip."""
    names, titles = (
        list(given) if len(given) == len(line.x) else [""] * len(line.x) for given in (line.names, line.titles)
    )
    points = zip(line.x, line.y, names, titles, strict=True)
    said = [(name, title) for a, b, name, title in points if _drawable((a, b), chart)]
    return [
        (x.place(a), y.place(b), name, f"{title or name or line.label}: {describe_number(a)}, {describe_number(b)}")
        for (a, b), (name, title) in zip(kept, said, strict=True)
    ]
