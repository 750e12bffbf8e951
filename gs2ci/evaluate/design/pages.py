"""The candidates of a design as JSON, CSV, text and a picture: quality against time, and the front.

Here: the record, and its layout. Not here: how quality is foreseen (`gs2ci.rig.design`) or checked (`checking`).
"""

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Final

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from gs2ci.core.durations import spoken_duration
from gs2ci.core.json_text import as_json

_DPI: Final = 120
_FORESEEN, _CHECKED, _CHOSEN = "#8a94a6", "#1f6feb", "#d1242f"
# The picture ends so far below the worst that was foreseen.
_BELOW_DB: Final = 3.0
# Rows of the text; the table has all.
_SHOWN: Final = 12


@dataclass(frozen=True)
class DesignRow:
    """One candidate.

    Args:
        masks: Masks of an exposure.
        density: Their open share.
        element: Sensor pixels per side of their elements.
        travel_mm: Travel of the camera during an exposure.
        exposures: How many of the same path, each under masks of its own.
        mask_s: How long each mask is shown.
        capture_s: What all take on the bench.
        computing_s: What their reconstruction takes at the size of the bench's picture, as expected from the checks.
        foreseen_db: Quality of the wanted views without a reconstruction, from the information of the coding.
        texture_db: The part of it that the masks leave open in the texture; likewise below.
        depth_db: What wrong depths displace.
        unseen_db: What no recorded view shows.
        decoded_db: What is left of the decode's error.
        saturated: Share of the readings that are clipped.
        checked_db: Quality by reconstructions of the small picture, their mean; None if it was not checked.
        checks: How many.
        views_db: Of the recorded views, in these reconstructions.
        unbeaten: Whether no other candidate takes less time of capture and of computing and is as good, as foreseen.
        chosen: Whether the rig file that is written takes it.
        left_out: Why it was not tried, or "".
    """

    masks: int
    density: float
    element: int
    travel_mm: float
    exposures: int
    mask_s: float | None = None
    capture_s: float | None = None
    computing_s: float | None = None
    foreseen_db: float | None = None
    texture_db: float | None = None
    depth_db: float | None = None
    unseen_db: float | None = None
    decoded_db: float | None = None
    saturated: float | None = None
    checked_db: float | None = None
    checks: int = 0
    views_db: float | None = None
    unbeaten: bool = False
    chosen: bool = False
    left_out: str = ""

    @property
    def quality_db(self) -> float | None:
        """Get the quality as checked, otherwise as foreseen."""
        return self.foreseen_db if self.checked_db is None else self.checked_db


@dataclass(frozen=True)
class Design:
    """What was found for a bench and a kind of scene.

    Args:
        bench: Name of the bench.
        scene: Name of the scene.
        size: Height and width of the small picture.
        preset: Of the checks.
        rows: All candidates.
        rig_file: The file that was written.
        commands: What takes and reconstructs the chosen exposures.
        command: What repeats this.
    """

    bench: str
    scene: str
    size: tuple[int, int]
    preset: str
    rows: tuple[DesignRow, ...]
    rig_file: str
    commands: tuple[str, ...]
    command: str = ""

    @property
    def chosen(self) -> DesignRow:
        """Get the chosen candidate."""
        return next(row for row in self.rows if row.chosen)

    @property
    def ranked(self) -> list[DesignRow]:
        """Get the candidates that were tried: those checked, best first, then the others as foreseen."""
        tried = [row for row in self.rows if row.foreseen_db is not None]
        return sorted(tried, key=lambda row: (row.checked_db is None, -(row.quality_db or 0.0)))


def unbeaten(times_and_quality: Sequence[tuple[float, float, float]]) -> list[bool]:
    """Tell of each (time of capture, time of computing, quality) whether no other is at least as good in all three.

    Of several that are equal in all, the first is unbeaten.
    """

    def beaten(number: int) -> bool:
        mine = times_and_quality[number]
        for other, theirs in enumerate(times_and_quality):
            good = theirs[0] <= mine[0] and theirs[1] <= mine[1] and theirs[2] >= mine[2]
            if other != number and good and (theirs != mine or other < number):
                return True
        return False

    return [not beaten(number) for number in range(len(times_and_quality))]


def as_csv(design: Design) -> str:
    """Lay all candidates out with full digits, one a line."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [field.name for field in fields(DesignRow)], lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in design.rows)
    return text.getvalue()


def record(design: Design) -> str:
    """Return the whole record as JSON."""
    return as_json(asdict(design))


def markdown(design: Design) -> str:
    """Return what was found in words, and a table of the best candidates."""
    ranked, chosen = design.ranked, design.chosen
    heads = ("candidate", "foreseen dB", "checked dB", "capture", "computing", "saturated")
    parts = [f"## Design of {design.bench} for {design.scene}", "", *sentences(design), ""]
    parts += ["| " + " | ".join(heads) + " |", "|---|" + "---:|" * (len(heads) - 1)]
    for row in ranked[:_SHOWN]:
        name = _name(row)
        parts.append("| " + " | ".join([f"**{name}**" if row == chosen else name, *_cells(row)]) + " |")
    if len(ranked) > _SHOWN:
        parts += ["", f"{len(ranked) - _SHOWN} more are in the table."]
    return "\n".join([*parts, "", *(f"    {line}" for line in design.commands), ""])


def sentences(design: Design) -> list[str]:
    """Return what was found in sentences."""
    chosen, left_out = design.chosen, [row for row in design.rows if row.left_out]
    many = sum(row.checks for row in design.rows)
    plural = "" if many == 1 else "s"
    checked = f"{many} reconstruction{plural} with the preset {design.preset} checked the best of them."
    by = "as checked" if chosen.checked_db is not None else "as foreseen"
    said = [
        f"Chosen: {_name(chosen)}: {chosen.quality_db or 0.0:.1f} dB {by} in a picture of {design.size[0]} x "
        f"{design.size[1]} px, {spoken_duration(chosen.capture_s or 0.0)} of capture"
        + ("." if chosen.computing_s is None else f", about {spoken_duration(chosen.computing_s)} of computing."),
        f"{len(design.rows) - len(left_out)} candidates were judged by what their coding tells, "
        + (checked if many else "and none by a reconstruction."),
    ]
    # One sentence for each kind of reason, with the figures of the first candidate that it leaves out.
    kinds: dict[str, list[str]] = {}
    for row in left_out:
        kinds.setdefault(row.left_out.partition(":")[0], []).append(row.left_out)
    for reasons in kinds.values():
        others = ", the first of them" if len(set(reasons)) > 1 else ""
        said.append(f"{len(reasons)} left out{others}: {reasons[0].rstrip('.')}.")
    return said


def _name(row: DesignRow) -> str:
    return f"{row.exposures} × {row.masks} masks, {100 * row.density:g} % open, {row.element} px, {row.travel_mm:g} mm"


def _cells(row: DesignRow) -> list[str]:
    def db(value: float | None) -> str:
        return "–" if value is None else f"{value:.2f}"

    def time(value: float | None) -> str:
        return "–" if value is None else spoken_duration(value)

    clipped = "–" if row.saturated is None else f"{100 * row.saturated:.1f} %"
    return [db(row.foreseen_db), db(row.checked_db), time(row.capture_s), time(row.computing_s), clipped]


def picture(design: Design) -> bytes:
    """Draw quality against time of capture and, if it is known, of computing as PNG, with the front."""
    shown = [("capture_s", "time of capture on the bench")]
    if design.chosen.computing_s is not None:
        shown.append(("computing_s", "time of computing, expected at full size"))
    figure = Figure(figsize=(1 + 5 * len(shown), 5.2), layout="constrained")
    panels = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
    for axes, (name, label) in zip(panels, shown, strict=True):
        _panel(axes, design, name, label)
    panels[0].set_ylabel("quality of the wanted views, PSNR, dB")
    chosen = design.chosen
    figure.suptitle(f"{design.bench}, {design.scene}: {_name(chosen)}", fontsize=11)
    shown_db = [row.foreseen_db or 0.0 for row in design.ranked]
    highest = max(*shown_db, *(row.checked_db or 0.0 for row in design.ranked))
    panels[0].set_ylim(min(shown_db) - _BELOW_DB, highest + 1)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=_DPI)
    return file.getvalue()


def _panel(axes: Axes, design: Design, name: str, label: str) -> None:
    rows = [row for row in design.ranked if getattr(row, name) is not None]
    times: dict[DesignRow, float] = {row: getattr(row, name) for row in rows}
    axes.scatter(
        [times[row] for row in rows], [row.foreseen_db or 0.0 for row in rows], s=16, color=_FORESEEN, label="foreseen"
    )
    front = sorted((times[row], row.foreseen_db or 0.0) for row in rows)
    stairs: list[tuple[float, float]] = []
    for at, value in front:
        if not stairs or value > stairs[-1][1]:
            stairs.append((at, value))
    if stairs:
        ends = [*stairs, (front[-1][0], stairs[-1][1])]
        axes.step(*zip(*ends, strict=True), where="post", color=_FORESEEN, linewidth=1, label="front, as foreseen")
    _reconstructed(axes, rows, times)
    axes.set(xscale="log", xlabel=label)
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda seconds, _place: spoken_duration(seconds)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(alpha=0.25, which="both", linewidth=0.5)


def _reconstructed(axes: Axes, rows: Sequence[DesignRow], times: Mapping[DesignRow, float]) -> None:
    """Draw what reconstructions gave, each joined to what was foreseen."""
    checked = [row for row in rows if row.checked_db is not None]
    for row in checked:
        axes.plot([times[row]] * 2, [row.foreseen_db or 0.0, row.checked_db or 0.0], color=_CHECKED, linewidth=0.6)
    axes.scatter([times[row] for row in checked], [row.checked_db or 0.0 for row in checked], s=34, color=_CHECKED,
                 label="checked by reconstructions", zorder=3)  # fmt: skip
    chosen = [row for row in rows if row.chosen]
    best = [times[row] for row in chosen], [row.quality_db or 0.0 for row in chosen]
    axes.scatter(*best, s=150, marker="*", color=_CHOSEN, label="chosen", zorder=4)
    lowest = min(row.foreseen_db or 0.0 for row in rows) - _BELOW_DB
    for row in checked:
        if (row.checked_db or 0.0) < lowest:  # far below: said, not drawn, so that the others can be told apart
            said = f"{row.checked_db:.1f} dB"
            axes.annotate(
                said, (times[row], lowest), (0, 4), textcoords="offset points", ha="right", fontsize=8, color=_CHECKED
            )
