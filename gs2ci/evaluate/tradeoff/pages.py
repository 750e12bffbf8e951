"""The trials of a shot as CSV, as a picture, as a section in markdown, and as the record for a run's page.

Here: the layout. Not here: the sentences (`front.py`), the trials (`trials.py`), the section of a run's page
(`gs2ci.evaluate.pages.tradeoff_section`).
"""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Final

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gs2ci.core.durations import spoken_duration
from gs2ci.core.whole_file import write_whole
from gs2ci.evaluate.environment import machine, versions
from gs2ci.evaluate.tradeoff.exposures import KNOB, draw_exposures, exposure_sentences
from gs2ci.evaluate.tradeoff.front import measure_of, pareto, sentences
from gs2ci.evaluate.tradeoff.record import HEADINGS, TITLES, TradeoffRecord, Tried
from gs2ci.evaluate.tradeoff.store import Row
from gs2ci.evaluate.tradeoff.trials import KNOBS

COLUMNS: Final = (
    "trial", "knob", "seconds", "psnr_db", "ssim", "nate", "heldout_db", "iterations", "gaussians", "verdict",
    "stopped", "exposures", "capture_s", "error",
)  # fmt: skip
# Distinguishable also with red-green blindness (Okabe and Ito 2008); the ladder is black.
_COLOURS: Final = ("#000000", "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")

# The next marker is used each time that all colours have been used.
_MARKERS: Final = ("D", "s", "^")


@dataclass(frozen=True)
class Tradeoff:
    """The results for one shot.

    Args:
        name: Name of the shot.
        rows: Rows of the trials, in their order; one that failed holds `error`.
        left_out: Trials that would have taken too long, with their predicted seconds.
        command: The command that repeats this.
    """

    name: str
    rows: Sequence[Row]
    left_out: Mapping[str, float] = field(default_factory=dict)
    command: str = ""

    @property
    def good(self) -> list[Row]:
        """Get the rows of the trials that did not fail."""
        return [row for row in self.rows if "error" not in row]


def write_pages(folder: Path, found: Tradeoff) -> list[Path]:
    """Write `tradeoff.csv`, `.png` and `.md`, and `exposures.png` if these were tried; return their paths.

    Each is written completely or not at all.

    Raises:
        StorageError: The disk refuses.
    """
    picture = io.BytesIO()
    draw(found).savefig(picture, format="png", dpi=150)
    made: dict[str, bytes | str] = {"csv": as_csv(found.rows), "png": picture.getvalue(), "md": markdown(found)}
    pages = [write_whole(folder / f"tradeoff.{ending}", content, parents=True) for ending, content in made.items()]
    measure = measure_of(found.good)
    if measure is None or not any(row["knob"] == KNOB for row in found.good):
        return pages
    picture = io.BytesIO()
    draw_exposures(found.good, measure, found.name).savefig(picture, format="png", dpi=150)
    return [*pages, write_whole(folder / "exposures.png", picture.getvalue(), parents=True)]


def as_csv(rows: Sequence[Row]) -> str:
    """Lay the rows out with full digits, a line per trial."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def record_of(found: Tradeoff) -> TradeoffRecord:
    """Return the values that a page needs, in plain form, with the machine on which the trials ran."""
    measure = measure_of(found.good)
    front = [] if measure is None else [row["trial"] for row in pareto(found.good, measure)]
    return TradeoffRecord(
        name=found.name,
        measure=measure,
        sentences=tuple(spoken(found)),
        trials=tuple(_tried(row, unbeaten=row["trial"] in front) for row in found.good),
        command=found.command,
        machine=machine(),
        versions=versions(),
    )


def _tried(row: Row, *, unbeaten: bool) -> Tried:
    figures: Row = {field.name: row[field.name] for field in fields(Tried) if field.name in row}
    return Tried(**figures, unbeaten=unbeaten)


def markdown(found: Tradeoff) -> str:
    """Return the section: the costs in words, then the table with the front in bold."""
    record = record_of(found)
    made = f"{record.machine['processor']}, {record.machine['usable_cores']} cores, gs2ci {record.versions['gs2ci']}"
    parts = [f"## What accuracy costs: {record.name}", "", *record.sentences, "", f"`{record.command}`; {made}.", ""]
    parts += ["| " + " | ".join(HEADINGS) + " |", "|---|" + "---:|" * (len(HEADINGS) - 1)]
    for trial in record.trials:
        name = f"**{trial.trial}**" if trial.unbeaten else trial.trial
        parts.append("| " + " | ".join([name, *trial.cells]) + " |")
    return "\n".join(parts).rstrip() + "\n"


def spoken(found: Tradeoff) -> list[str]:
    """Return sentences on what was found, what failed and what was left out."""
    said = sentences(found.good) if found.good else []
    said += exposure_sentences(found.good, measure_of(found.good))
    said += [f"{row['trial']} failed: {row['error']}" for row in found.rows if "error" in row]
    said += [f"{name} was left out: it would take about {spoken_duration(s)}." for name, s in found.left_out.items()]
    return said


def draw(found: Tradeoff) -> Figure:
    """Draw quality against seconds, a colour for each setting that was changed, the front as a staircase."""
    figure = Figure(figsize=(9.2, 5.0), layout="constrained")
    axes = figure.add_subplot()
    measure = measure_of(found.good)
    axes.set_xscale("log")
    axes.set_xlabel("seconds, from the measurement to its views")
    axes.set_ylabel("" if measure is None else TITLES[measure])
    axes.set_title(f"What accuracy costs: {found.name}", loc="left", fontsize=11)
    axes.grid(color="#e4e4e4", which="both", linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    if measure is None:
        return figure
    known = [row for row in found.good if row.get(measure) is not None]
    front = pareto(known, measure)
    stairs = [row["seconds"] for row in front], [row[measure] for row in front]
    axes.step(*stairs, where="post", color="#999999", linewidth=1.2, zorder=1)
    axes.scatter(*stairs, s=110, facecolors="none", edgecolors="#999999", linewidths=1.2, zorder=2)
    handles = [_key(row, number) for number, row in enumerate(known, 1)]
    for number, (row, key) in enumerate(zip(known, handles, strict=True), 1):
        place = (row["seconds"], row[measure])
        axes.plot(*place, marker=key.get_marker(), color=key.get_color(), markersize=6, zorder=3)
        axes.annotate(f"{number}", place, (5, 5), textcoords="offset points", fontsize=8, color=key.get_color())
    axes.margins(x=0.08, y=0.08)
    # Names beside the points would cover each other where trials are alike.
    axes.legend(handles=handles, frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.01, 0.5))
    return figure


def _key(row: Row, number: int) -> Line2D:
    """Return a line of the legend: the trial's number and name, in the colour of what it changes."""
    knob = (*KNOBS, KNOB).index(row["knob"])
    marker, colour = "o" if knob == 0 else _MARKERS[knob // len(_COLOURS)], _COLOURS[knob % len(_COLOURS)]
    return Line2D([], [], linestyle="", marker=marker, color=colour, label=f"{number}  {row['trial']}")
