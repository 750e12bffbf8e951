"""`gs2ci plan`: which physical effects a simulated exposure must include, and why. Nothing is exposed.

Here: the tables. Not here: the plan (`gs2ci.api.plans`), derivations (`gs2ci_sims.explaining`).
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from gs2ci.api import plans
from gs2ci.api.derived import with_options_of
from gs2ci.api.display import open_display
from gs2ci.commands.answers import AsJson, answered
from gs2ci.commands.lines import say
from gs2ci.core.errors import InputError
from gs2ci.core.whole_file import check_earlier, check_place, write_whole

if TYPE_CHECKING:
    from gs2ci_sims.explaining import Explanation
    from gs2ci_sims.simulation_plan import Plan
    from gs2ci_sims.sweeping import FigureSweep

# What a picture that matplotlib drew has near its beginning.
_DRAWN: Final = b"Matplotlib"
LAW_WIDTH: Final = 32
"""Largest width of the column of laws in characters; a longer law gets a separate line."""


@with_options_of(plans.plan)
def run(
    rig: tyro.conf.Positional[Path],
    *,
    explain: tuple[str, ...] = (),
    sweep: tuple[str, ...] = (),
    points: int = 9,
    picture: Path | None = None,
    json: AsJson = False,
    **options: Any,
) -> None:
    """Print which of a rig's effects would be simulated: bound, decision, reason, sampling, share of the time.

    Args:
        rig: The rig file (TOML) of a simulated bench (docs/rigs/simulated.toml) or of a simulation alone
            (docs/simulation.md).
        explain: Names of effects, or "all": derive their bounds step by step, with this rig's numbers.
        sweep: Parameters of the rig file to vary, each NAME=LOW..HIGH (travel, mask_s, aperture or a dotted key), to
            find the value from which each effect matters.
        points: Values per parameter of the sweep.
        picture: A PNG file for the map of the sweep.
    """
    if picture is not None and not sweep:
        raise InputError("--picture without --sweep", remedy="say what to sweep: --sweep mask_s=0.001..0.1")
    if explain and sweep:
        raise InputError("--explain with --sweep", allowed="one of the two", remedy="explain one plan at a time")
    with answered(json) as answer:
        if sweep:
            answer({"sweeps": _swept(rig, sweep, points, picture, **options)})
            return
        decided = plans.plan(rig, **options)
        console = Console(highlight=False)
        if explain:
            found = plans.explain(decided, explain)
            for one in found:
                print_explanation(one, console)
            answer({"tolerance_dn": decided.tolerance_dn, "explanations": [one.record() for one in found]})
            return
        print_plan(decided, console)
        answer({**decided.record(), "seconds": decided.seconds})


def _swept(
    rig: Path, quantities: tuple[str, ...], points: int, picture: Path | None, **options: Any
) -> list[dict[str, Any]]:
    from gs2ci.api.sweeps import sweep
    from gs2ci_sims.sweeping import picture as drawn

    if picture is not None:
        check_place(picture)
        check_earlier(picture, _DRAWN, "a drawing")
    figures = [figure for text in quantities for figure in text.split(",")]
    with open_display() as display:
        sweeps = sweep(rig, figures, points=points, progress=display, **options)
    console = Console(highlight=False)
    print_sweeps(sweeps, console)
    if picture is not None:
        write_whole(picture, drawn(sweeps))
        say(f"map of regimes: {picture}")
    return [one.record() for one in sweeps]


def print_sweeps(sweeps: "Sequence[FigureSweep]", console: Console) -> None:
    """Print from which value each effect matters, one effect per line, one column per swept parameter."""
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    table.add_column("matters for", no_wrap=True)
    for one in sweeps:
        table.add_column(f"{one.quantity}, {one.unit}" if one.unit else one.quantity)
    for name in dict.fromkeys(name for one in sweeps for name in one.bounds_dn):
        table.add_row(name, *(_ranges(one, name) for one in sweeps))
    table.add_row("(views)", *(f"{min(one.views)} to {max(one.views)}" for one in sweeps))
    table.add_row("(swept)", *(f"{one.values[0]:.3g} to {one.values[-1]:.3g}" for one in sweeps), style="dim")
    table.add_row("(the file's)", *("-" if one.own is None else f"{one.own:.3g}" for one in sweeps), style="dim")
    console.print(table)


def _ranges(one: "FigureSweep", name: str) -> str:
    if name not in one.bounds_dn:
        return "-"
    words = []
    for low, high in one.regimes(name):
        if math.isinf(low) and math.isinf(high):
            words.append("all")
        elif math.isinf(low):
            words.append(f"below {high:.3g}")
        else:
            words.append(f"above {low:.3g}" if math.isinf(high) else f"{low:.3g} to {high:.3g}")
    return ", ".join(words) or "none"


def print_plan(decided: "Plan", console: Console) -> None:
    """Print a plan as a table, one effect per line in physical order, and its one-line summary."""
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for title in ("effect", "DN rms", "simulated", "why", "samples", "time"):
        side: Literal["left", "right"] = "right" if title in ("DN rms", "time") else "left"
        wraps = title in ("why", "samples")  # the others say nothing true if they are cut
        table.add_column(title, justify=side, no_wrap=not wraps, overflow="fold", min_width=len(title))
    table.add_row("(views)", "", "yes", "what is seen", f"{decided.views}", _share(decided.render_seconds, decided))
    for decision in decided.decisions:
        bound = decision.bound.rms_dn
        table.add_row(
            decision.name,
            "-" if math.isinf(bound) else f"{bound:.3g}",
            "yes" if decision.simulated else "no",
            decision.why,
            decision.sampling,
            _share(decision.seconds, decided) if decision.simulated else "",
            style="" if decision.simulated else "dim",
        )
    console.print(table)
    console.print(decided.summary(), markup=False, soft_wrap=True)


def print_explanation(one: "Explanation", console: Console) -> None:
    """Print the derivation of an effect's bound, one step per line, and the decision."""
    console.print(f"[bold]{one.name}[/bold]: {escape(one.what)}", soft_wrap=True)
    console.print(f"Bound: {escape(one.law)}", soft_wrap=True)
    laws = [f"{step.symbol} = {step.law}" if step.law else step.symbol for step in one.steps]
    width = max((len(law) for law in laws if len(law) <= LAW_WIDTH), default=0)
    for law, step in zip(laws, one.steps, strict=True):
        begin = f"{law:<{width}}" if len(law) <= width else f"{law}\n  {'':<{width}}"
        line = f"  {begin}  {step.value:>10.4g} {step.unit:<9} {step.what}"
        console.print(line, markup=False, soft_wrap=True)
    console.print(one.verdict + ".\n", markup=False, soft_wrap=True)


def _share(seconds: float, decided: "Plan") -> str:
    return f"{100 * seconds / max(decided.seconds, 1e-12):.1f} %"
