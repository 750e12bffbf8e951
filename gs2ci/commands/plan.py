"""`gs2ci plan`: which physical effects a simulated exposure calls for, and why. Nothing is exposed.

Here: the tables. Not here: the plan (`gs2ci.api.plans`), derivations (`gs2ci_sims.explaining`).
"""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import tyro
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from gs2ci.api.plans import plan
from gs2ci.commands.answers import answered

if TYPE_CHECKING:
    from gs2ci_sims.explaining import Explanation
    from gs2ci_sims.planner import Plan

LAW_WIDTH: Final = 32
"""Characters that the column of laws is widened to; a longer law has a line of its own."""


def run(
    rig: tyro.conf.Positional[Path],
    *,
    tolerance_dn: float | None = None,
    rays: bool = False,
    explain: tuple[str, ...] = (),
    json: bool = False,
) -> None:
    """Print what would be simulated of a rig's effects: bound, decision, reason, sampling, share of the time.

    Args:
        rig: The rig file (TOML) of a simulated bench (docs/rigs/simulated.toml) or of a simulation alone
            (docs/simulation.md).
        tolerance_dn: In total, DN rms; that of the rig file if not given.
        explain: Names of effects, or "all": derive their bounds step by step, with this rig's numbers.
        json: Print the answer as JSON, and nothing else, on standard output.
        rays: Count what the rasteriser is off by, and draw Gaussians ray by ray where that is too much.
    """
    with answered(as_text=not json) as answer:
        decided = plan(rig, tolerance_dn, rays=rays)
        console = Console(highlight=False)
        if explain:
            from gs2ci_sims.explaining import explain as explained

            found = explained(decided, explain)
            for one in found:
                print_explanation(one, console)
            answer({"tolerance_dn": decided.tolerance_dn, "explanations": [one.record() for one in found]})
            return
        print_plan(decided, console)
        answer({**decided.record(), "seconds": decided.seconds})


def print_plan(decided: "Plan", console: Console) -> None:
    """Print a plan as a table, one effect per line in physical order, and its one-line summary."""
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for title in ("effect", "DN rms", "simulated", "why", "samples", "time"):
        side: Literal["left", "right"] = "right" if title in ("DN rms", "time") else "left"
        table.add_column(title, justify=side, no_wrap=title != "samples", min_width=len(title))
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
    """Print the derivation of an effect's bound, one step per line, and what was decided on it."""
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
