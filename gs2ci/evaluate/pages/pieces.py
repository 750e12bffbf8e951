"""The parts of a page's sections; every function returns markup, every argument is text or numbers.

    masthead    the verdict on top: headline, sentences, the figures that matter
    table       rows under headings; numbers stand right
    sortable_table  rows that a click on a heading sorts, with pictures and links
    facts       names and values
    figure      a picture (PNG, JPEG or WebP bytes, or inline markup) with its caption
    chart       a chart (`charts.py`) with its numbers in a fold
    sentences   notes, one paragraph each
    steps       what to do next: what, why, the command
    columns     two pieces beside each other where there is room

Not here: the page (`frame.py`), the contents of a run's sections (`run_page.py`).
"""

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

from markupsafe import Markup

from gs2ci.core.errors import InputError
from gs2ci.evaluate.pages.charts import Bar, Chart, bars_svg, chart_svg, chart_table
from gs2ci.evaluate.pages.frame import fit, piece
from gs2ci.evaluate.pages.pictures import Picture, media_type
from gs2ci.evaluate.wording import describe_value

Tone = Literal["good", "mixed", "poor"]

# Reports may be of any size; a page shows this many rows and says how many it left out.
MOST_ROWS: Final = 250
MOST_SORTABLE: Final = 2000
MOST_CHARACTERS: Final = 600


@dataclass(frozen=True)
class FigureOfMerit:
    """One figure of merit: value, name, and what to compare it with."""

    value: str
    label: str
    remark: str = ""


def masthead(
    headline: str, sentences: Sequence[str], figures: Sequence[FigureOfMerit], tone: Tone, word: str
) -> Markup:
    """Return the top of a page: the outcome; `word` says in text what the colour of `tone` says."""
    return piece("masthead", headline=headline, sentences=sentences, figures=figures, tone=tone, word=word)


def table(
    headings: Sequence[str],
    rows: Iterable[Sequence[Any]],
    *,
    caption: str = "",
    marked: Container[tuple[int, int]] = (),
) -> Markup:
    """Set rows of plain values under headings; a column with only numbers and dashes is right-aligned.

    Args:
        headings: One for each column.
        rows: Rows with as many cells.
        caption: Text over the table.
        marked: Cells to set off from the rest, (row, column) from 0 on.
    """
    listed = [[describe_value(cell) for cell in row] for row in rows]
    shown = [[_short(cell) for cell in row] for row in listed[:MOST_ROWS]]
    numeric = [all(_is_number(row[column]) for row in shown) for column in range(len(headings))]
    return piece(
        "table",
        headings=headings,
        rows=shown,
        numeric=numeric,
        marked=marked,
        caption=caption,
        left_out=len(listed) - len(shown),
    )


@dataclass(frozen=True)
class SortableCell:
    """One cell of a table that can be sorted.

    Args:
        text: Its text.
        number: Number by which it is sorted; None sorts by the text, or last among numbers.
        link: A relative address; "" for none.
        picture: A picture before the text.
    """

    text: str
    number: float | None = None
    link: str = ""
    picture: Picture | None = None


def sortable_table(headings: Sequence[str], rows: Sequence[Sequence[SortableCell]]) -> Markup:
    """Set rows whose order the reader may change; a column that contains a number is sorted by numbers.

    Args:
        headings: One for each column; a column without a heading cannot be sorted by.
        rows: Rows with as many cells.
    """
    shown = rows[:MOST_SORTABLE]
    numeric = [any(row[column].number is not None for row in shown) for column in range(len(headings))]
    return piece(
        "sortable_table", headings=headings, rows=shown, numeric=numeric, left_out=max(0, len(rows) - MOST_SORTABLE)
    )


def facts(rows: Mapping[str, Any] | Iterable[tuple[str, Any]]) -> Markup:
    """Set names and their values side by side."""
    pairs = list(rows.items() if isinstance(rows, Mapping) else rows)
    shown = [(_short(name), _short(describe_value(value))) for name, value in pairs[:MOST_ROWS]]
    return piece("facts", rows=shown, left_out=len(pairs) - len(shown))


def figure(picture: bytes | Markup, alt: str, *, caption: str = "") -> Markup:
    """Set a picture with its caption.

    Args:
        picture: The bytes of a PNG, JPEG or WebP file, or inline markup such as a chart's SVG.
        alt: Description of the picture, for readers who cannot see it.
        caption: Text under it.

    Raises:
        InputError: The bytes are none of these formats.
    """
    if isinstance(picture, Markup):
        return piece("inline_figure", markup=picture, caption=caption)
    kind = media_type(picture)
    if kind is None:
        raise InputError("a picture of unknown format for a page", allowed="the bytes of a PNG, JPEG or WebP file")
    return piece("picture_figure", picture=Picture(picture, kind), alt=alt, caption=caption)


def chart(drawn: Chart, *, caption: str = "", tabled: bool = True) -> Markup:
    """Set a chart, drawn once for wide and once for narrow pages.

    Args:
        drawn: The chart.
        caption: Text under it.
        tabled: Whether its numbers are listed below, in a fold.
    """
    parts = {
        "wide": chart_svg(drawn, 760, 320),
        "narrow": chart_svg(drawn, 340, 270),
        "legend": [(line.label, line.colour, line.style) for line in drawn.lines] if len(drawn.lines) > 1 else [],
        "caption": caption,
    }
    return piece("chart", numbers=table(*chart_table(drawn)), **parts) if tabled else piece("chart_frame", **parts)


def bars(parts: Sequence[Bar], *, unit: str) -> Markup:
    """Set the parts of a whole as one bar, named and counted below."""
    return piece("bars", drawing=bars_svg(parts, unit), parts=parts, unit=unit)


def sentences(texts: Iterable[str], *, empty: str) -> Markup:
    """Set notes, a paragraph each; `empty` if there is none."""
    listed = [_short(text) for text in texts]
    return piece("sentences", texts=listed[:MOST_ROWS], empty=empty, left_out=max(0, len(listed) - MOST_ROWS))


def steps(listed: Sequence[Any], *, title: str, empty: str) -> Markup:
    """Set what to do next (`next_steps.NextStep`)."""
    return piece("steps", steps=listed, title=title, empty=empty)


def columns(*parts: Markup) -> Markup:
    """Set pieces side by side if there is room."""
    return piece("columns", parts=parts)


def paragraph(text: str) -> Markup:
    """Set a paragraph."""
    return piece("paragraph", text=text)


def _short(text: str) -> str:
    text = fit(text)
    return text if len(text) <= MOST_CHARACTERS else text[:MOST_CHARACTERS] + "…"


def _is_number(cell: str) -> bool:
    return cell == "–" or (cell[:1].isdigit() or cell[:2].lstrip("-+−<≥≤≈")[:1].isdigit())
