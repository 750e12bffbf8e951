"""The trials of a shot as CSV, as a section in markdown, and as the record for a page.

Here: the layout. Not here: the sentences (`front.py`), the trials (`trials.py`), chart and page
(`gs2ci.evaluate.pages.tradeoff_section`).
"""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Final

from gs2ci.core.durations import spoken_duration
from gs2ci.core.whole_file import write_whole
from gs2ci.evaluate.environment import machine, versions
from gs2ci.evaluate.tradeoff.exposures import exposure_sentences
from gs2ci.evaluate.tradeoff.front import measure_of, pareto, sentences
from gs2ci.evaluate.tradeoff.record import HEADINGS, TradeoffRecord, Tried
from gs2ci.evaluate.tradeoff.store import Row

COLUMNS: Final = (
    "trial", "knob", "seconds", "psnr_db", "ssim", "nate", "heldout_db", "iterations", "gaussians", "verdict",
    "stopped", "exposures", "capture_s", "error",
)  # fmt: skip


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
    """Write `tradeoff.csv` and `tradeoff.md`, each completely or not at all; return their paths.

    Raises:
        StorageError: The disk refuses.
    """
    made = {"csv": as_csv(found.rows), "md": markdown(found)}
    return [write_whole(folder / f"tradeoff.{ending}", content, parents=True) for ending, content in made.items()]


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
    made = f"{record.machine.processor}, {record.machine.usable_cores} cores, gs2ci {record.versions['gs2ci']}"
    # From Python there is no command.
    how = f"`{record.command}`; {made}" if record.command else made
    parts = [f"## What accuracy costs: {record.name}", "", *record.sentences, "", f"{how}.", ""]
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
