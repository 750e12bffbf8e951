"""The page and the figure of the hard cases: cases × outcome, with the loss in dB against the easy case.

Not here: running or judging anything (`__main__`, `judge`).
"""

from collections import Counter
from datetime import date
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tests.stability.benches import FULL
from tests.stability.cases import Case
from tests.stability.judge import BENDS_DB, DEPTH_BENDS, RANK_BENDS, Outcome
from tests.stability.order import DROWNS_PX, EVEN_PER_PX

Row = tuple[Case, Outcome]
GRADES = ("holds", "bends", "breaks", "refused")
# Okabe and Ito's colours: told apart by everybody.
COLOURS = {"holds": "#009E73", "bends": "#E69F00", "breaks": "#D55E00"}
# Loss and gain beyond these are drawn up to here.
SHOWN_DB = (-6.0, 18.0)
COLUMNS = 3
SAID_LENGTH = 150
IMAGE = "images/stability.png"
INTRODUCTION = """# Hard cases

Written by `make stability` on {day}; a quick part runs in `make test`. Each case is a measurement that is hard in one
way, made by the simulator or by hand, and processed from exposure and file to reconstruction and report. Pictures are
{width} × {height}, with at most {iterations} iterations: compare losses; absolute values say little about large
pictures. Each case is one draw of masks and noise.

A case passes if its result is finite, bounded, honest (a loss of more than {bends:g} dB is reported, unless nothing
in the measurement could show what is wrong; near and far exchanged, or the path reversed, only with a report that
depth is not known) and no worse than the decode alone; or if it is refused with one typed error, if that is the right
outcome. A lens that is out of focus is judged by the image that it forms, because it cannot be distinguished from a
sharp one in front of a scene without fine detail.

| outcome | meaning |
|---|---|
| holds | loses at most {bends:g} dB against the easy case of its own scene |
| bends | loses more, and still shows more than an even grey |
| breaks | shows no more than an even grey, or its depth order or its path is reversed (near and far exchanged) |
| refused | one typed error that says what to do |

The depth of the middle view is graded separately, against the same easy case. It *holds* if its median relative error
is at most twice that of the easy case plus {depth:.0%}, and its rank correlation with the true depth at most {rank:g}
smaller. Otherwise it *bends*, and it *breaks* if near and far are exchanged or no depth is found. It is left open if
the easy case does not find the depth either, or if near and far cannot be distinguished: the best rotation explains
the true motion to {drowns:g} px rms, or the views change by less than {even:.1%} of full scale from pixel to pixel.
Then the run has to say so, and the case is graded by its views. Near and far are *exchanged* if the rank correlation
is below zero by more than two of its standard errors, which take into account how few patches of one depth there are;
a smaller value is chance, and has to be reported as well.
"""


def write_page(docs: Path, rows: list[Row]) -> Path:
    """Write page and figure into the folder of the docs; return the page."""
    page = docs / "stability.md"
    (docs / "images").mkdir(exist_ok=True)
    draw(docs / IMAGE, rows)
    height, width = FULL.size
    head = INTRODUCTION.format(
        day=date.today().isoformat(),
        width=width,
        height=height,
        iterations=FULL.iterations,
        bends=BENDS_DB,
        depth=DEPTH_BENDS,
        rank=RANK_BENDS,
        drowns=DROWNS_PX,
        even=EVEN_PER_PX,
    )
    parts = [head, _summary(rows), f"![Loss of every case against the easy one]({IMAGE})\n", _broken(rows)]
    parts += [_table(family, [row for row in rows if row[0].family == family]) for family in _families(rows)]
    page.write_text("\n".join(parts), encoding="utf-8")
    return page


def _families(rows: list[Row]) -> list[str]:
    return list(dict.fromkeys(case.family for case, _ in rows))


def _summary(rows: list[Row]) -> str:
    lines = ["## At a glance\n", f"| family | cases | {' | '.join(GRADES)} |", "|---|---" + "|---" * len(GRADES) + "|"]
    for family in [*_families(rows), "all"]:
        grades = Counter(outcome.grade for case, outcome in rows if family in (case.family, "all"))
        counts = " | ".join(str(grades[grade] or "") for grade in GRADES)
        lines.append(f"| {family} | {grades.total()} | {counts} |")
    failed = sum(bool(outcome.problems) for _, outcome in rows)
    lines.append(f"\n{len(rows)} cases, {failed} that did not pass.\n")
    return "\n".join(lines)


def _broken(rows: list[Row]) -> str:
    """Name what breaks, and what only bends."""
    parts = []
    for grade, title in (("breaks", "Where it breaks"), ("bends", "Where it bends")):
        titles = [case.title for case, outcome in rows if outcome.grade == grade]
        parts.append(f"**{title}:** {'; '.join(titles) or 'nowhere'}.\n")
    return "\n".join(parts)


def _table(family: str, rows: list[Row]) -> str:
    lines = [
        f"## {family.capitalize()}\n",
        "| case | outcome | PSNR, dB | loss, dB | above the decode, dB | depth | off, % | rank | what the run says |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for case, outcome in rows:
        above = None
        if outcome.psnr_db is not None and outcome.decode_db is not None:
            above = outcome.psnr_db - outcome.decode_db
        figures = " | ".join(_decimal(value) for value in (outcome.psnr_db, outcome.loss_db, above))
        lines.append(f"| {case.name} | {outcome.grade} | {figures} | {_depth(outcome)} | {_said(case, outcome)} |")
    return "\n".join(lines) + "\n"


def _depth(outcome: Outcome) -> str:
    grade, depth = "" if outcome.depth_grade == "unknown" else outcome.depth_grade, outcome.depth
    grade = "open" if outcome.order_open else grade
    return f"{grade} | | " if depth is None else f"{grade} | {100 * depth.median_rel:.0f} | {depth.rank:.2f}"


def _decimal(value: float | None) -> str:
    return "" if value is None else f"{value:.1f}".replace("-0.0", "0.0")


def _said(case: Case, outcome: Outcome) -> str:
    problems = "".join(f"**{problem}** " for problem in outcome.problems)
    if case.silent and not outcome.said:
        return f"{problems}*nothing can: {case.silent}*"
    first = outcome.said[0] if outcome.said else ""
    short = first if len(first) <= SAID_LENGTH else first[:SAID_LENGTH].rsplit(" ", 1)[0] + " …"
    more = f" (and {len(outcome.said) - 1} more)" if len(outcome.said) > 1 else ""
    return (problems + short + more).replace("|", "\\|")


def draw(path: Path, rows: list[Row]) -> None:
    """Draw a bar for every case that has a loss; what only has to be survived is left to the table."""
    shown = [row for row in rows if row[1].loss_db is not None and row[0].family not in ("easy", "numbers", "fault")]
    families = _families(shown)
    columns = _split(families, shown)
    tallest = max(len(column) + len(_families(column)) for column in columns)
    figure = Figure(figsize=(5.6 * COLUMNS, 0.175 * tallest + 1.2), dpi=110)
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, COLUMNS, sharex=True)
    for axis, column in zip(axes, columns, strict=True):
        _draw_column(axis, column, tallest)
    handles = [axes[0].barh([0], [0], color=colour, label=grade) for grade, colour in COLOURS.items()]
    figure.legend(handles=handles, loc="upper right", ncols=3, frameon=False)
    figure.suptitle("Hard cases: loss in dB against the easy case", x=0.02, ha="left", fontweight="bold")
    figure.tight_layout(rect=(0, 0, 1, 0.985))
    figure.savefig(path)


def _split(families: list[str], rows: list[Row]) -> list[list[Row]]:
    """Deal families out to columns of about the same height."""
    lines = {family: 1 + sum(case.family == family for case, _ in rows) for family in families}
    share = sum(lines.values()) / COLUMNS
    columns: list[list[Row]] = [[] for _ in range(COLUMNS)]
    drawn = 0
    for family in families:
        column = min(COLUMNS - 1, int((drawn + lines[family] / 2) / share))
        columns[column] += [row for row in rows if row[0].family == family]
        drawn += lines[family]
    return columns


def _draw_column(axis: Axes, rows: list[Row], tallest: int) -> None:
    place, ticks, names = 0, [], []
    for family in _families(rows):
        axis.text(SHOWN_DB[0], place, family.upper(), fontsize=7, fontweight="bold", va="center")
        place += 1
        for case, outcome in rows:
            if case.family == family:
                _draw_bar(axis, place, outcome)
                ticks.append(place)
                names.append(case.name)
                place += 1
    axis.set_yticks(ticks, names, fontsize=7)
    axis.set_ylim(tallest - 0.4, -0.8)
    axis.set_xlim(*SHOWN_DB)
    axis.axvline(0, color="0.3", linewidth=0.8)
    axis.axvline(BENDS_DB, color="0.7", linewidth=0.8, linestyle=":")
    axis.set_xlabel("dB lost")
    axis.tick_params(axis="y", length=0)
    axis.spines[["top", "right", "left"]].set_visible(False)


def _draw_bar(axis: Axes, place: int, outcome: Outcome) -> None:
    loss = outcome.loss_db
    assert loss is not None
    # Room for the figure at either end of the bar.
    drawn = min(max(loss, SHOWN_DB[0] + 2.5), SHOWN_DB[1] - 2.0)
    side, gap = ("left", 0.15) if loss >= 0 else ("right", -0.15)
    axis.barh(place, drawn, height=0.72, color=COLOURS[outcome.grade])
    axis.text(drawn + gap, place, _decimal(loss), fontsize=6, va="center", ha=side)
