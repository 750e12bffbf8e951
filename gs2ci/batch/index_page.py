"""The page over many runs: a line each with a small picture and figures, sortable, linked to the runs' own pages.

Here: the page's contents. Not here: its parts (`gs2ci.evaluate.pages`), the rows (`rows`).
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final
from urllib.parse import quote

import numpy as np
from markupsafe import Markup

from gs2ci.batch.rows import Row
from gs2ci.core.whole_file import write_whole
from gs2ci.evaluate.pages import pieces
from gs2ci.evaluate.pages.frame import PageSection, page
from gs2ci.evaluate.pages.pictures import Picture, encode, shrink, to_eight_bit
from gs2ci.evaluate.pages.pieces import FigureOfMerit, SortableCell, Tone

PAGE_NAME: Final = "index.html"
_THUMBNAIL_PX: Final = 112
_QUALITY: Final = 70

# Heading, the figure, its digits; a column that no row has a figure for is left out.
_FIGURES: Final[tuple[tuple[str, Callable[[Row], float | None], int], ...]] = (
    ("PSNR, dB", lambda row: row.psnr_db, 2),
    ("SSIM", lambda row: row.ssim, 3),
    ("nATE", lambda row: row.nate, 3),
    ("path error expected", lambda row: row.path_error_expected, 3),
    ("held-out rms", lambda row: row.heldout_rms, 4),
    ("residual rms", lambda row: row.residual_rms, 4),
    ("doubts", lambda row: row.doubts, 0),
    ("views", lambda row: row.views, 0),
    ("Gaussians", lambda row: row.gaussians, 0),
    ("seconds", lambda row: row.seconds, 1),
)


def write_index(output: Path, rows: Sequence[Row]) -> Path:
    """Write `index.html` over the runs of a folder; return its path.

    Raises:
        StorageError: The disk refuses.
    """
    return write_whole(output / PAGE_NAME, index_page(output, rows), parents=True)


def index_page(output: Path, rows: Sequence[Row]) -> str:
    """Lay rows out as a page: how many succeeded, then a table of all.

    Args:
        output: The folder of runs, from which pictures are read.
        rows: Rows in their initial order.
    """
    figures = [one for one in _FIGURES if any(one[1](row) is not None for row in rows)]
    table = pieces.sortable_table(
        ["", "run", "state", *(heading for heading, _, _ in figures)],
        [
            [
                SortableCell("", picture=_thumbnail(output, row), link=_link(row)),
                SortableCell(row.name, link=_link(row)),
                SortableCell(row.verdict or "" if row.state == "done" else row.state),
                *(_figure(value(row), digits) for _, value, digits in figures),
            ]
            for row in rows
        ],
    )
    sections = [PageSection("Runs", table, "A click on a heading sorts; a second one turns the order round.")]
    told = [f"{row.name}: {row.problem.kind}: {row.problem.problem}" for row in rows if row.problem is not None]
    if told:
        sections.append(PageSection("What could not be reconstructed", pieces.sentences(told, empty="")))
    return page("Many exposures", sections, masthead=_masthead(rows), eyebrow="gs2ci reconstruct · many exposures")


def _masthead(rows: Sequence[Row]) -> Markup:
    done = [row for row in rows if row.state == "done"]
    tone: Tone = "good" if len(done) == len(rows) else "mixed" if done else "poor"
    word = {"good": "Complete", "mixed": "With gaps", "poor": "Nothing succeeded"}[tone]
    psnr = [row.psnr_db for row in done if row.psnr_db is not None]
    merits = [FigureOfMerit(f"{len(done)}", "reconstructed", f"of {len(rows)}")]
    if psnr:
        merits.append(FigureOfMerit(f"{np.mean(psnr):.2f} dB", "PSNR", f"{min(psnr):.2f} to {max(psnr):.2f}"))
    merits.append(FigureOfMerit(f"{sum(bool(row.doubts) for row in done)}", "with doubts", f"of {len(done)}"))
    merits.append(FigureOfMerit(f"{sum(row.seconds or 0.0 for row in done) / 60:.1f} min", "of work"))
    return pieces.masthead(f"{len(done)} of {len(rows)} exposures reconstructed", [], merits, tone, word)


def _figure(value: float | None, digits: int) -> SortableCell:
    if value is None or not math.isfinite(value):
        return SortableCell("–")
    return SortableCell(f"{value:.{digits}f}", number=float(value))


def _link(row: Row) -> str:
    return f"{quote(row.name)}/report.html" if row.state == "done" else ""


def _thumbnail(output: Path, row: Row) -> Picture | None:
    """Return the middle view of a run, small; None if it cannot be read."""
    if row.state != "done":
        return None
    try:
        views = np.load(output / row.name / "views.npy", mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError):
        return None
    if views.ndim != 4 or views.shape[3] not in (1, 3) or not views.size:
        return None
    return encode(shrink(to_eight_bit(views[len(views) // 2]), _THUMBNAIL_PX), quality=_QUALITY)
