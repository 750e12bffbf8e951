"""`gs2ci plan`: which physical effects a simulated exposure calls for, and why. Nothing is exposed.

Here: the table. Not here: the reckoning (`gs2ci_sims.planner`).
"""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro
from rich.console import Console
from rich.table import Table

from gs2ci.commands.options import check_number
from gs2ci.core.errors import InputError

if TYPE_CHECKING:
    from gs2ci_sims.planner import Plan


def run(rig: tyro.conf.Positional[Path], *, tolerance_dn: float | None = None, rays: bool = False) -> None:
    """Print what would be simulated of a rig's effects: bound, decision, reason, sampling, share of the time.

    Args:
        rig: The rig file (TOML) of a simulated bench (docs/rigs/simulated.toml) or of a simulation alone
            (docs/simulation.md).
        tolerance_dn: In total, DN rms; that of the rig file if not given.
        rays: Count what the rasteriser is off by, and draw Gaussians ray by ray where that is too much.
    """
    check_number("--tolerance-dn", tolerance_dn, above=0, remedy="leave --tolerance-dn out for the rig file's number")
    print_plan(plan_of(rig, tolerance_dn, rays=rays), Console(highlight=False))


def plan_of(rig: Path, tolerance_dn: float | None = None, *, rays: bool = False) -> "Plan":
    """Plan the exposure of a rig file, with its own tolerance or another, counting the rasteriser's error or not.

    Raises:
        InputError: The file cannot be read, describes a bench of real devices, or a simulated bench with `rays`.
    """
    from gs2ci.core.config import read_toml
    from gs2ci.rig.config import describes_simulation

    if not describes_simulation(read_toml(rig)[0]):
        from gs2ci.rig.config import read_rig
        from gs2ci.rig.foreseen import foreseen_plan
        from gs2ci.rig.opening import Rig

        if rays:
            raise InputError(
                f"--rays for the bench of {rig}",
                allowed="the rig file of a simulation alone",
                remedy="leave --rays out",
            )
        return foreseen_plan(Rig(*read_rig(rig), rig.parent), tolerance_dn)
    from gs2ci_sims.exact import ExactRenderer
    from gs2ci_sims.planner import plan
    from gs2ci_sims.rig_file import read_rig_file

    setup = read_rig_file(rig)
    scene = setup.scene.build()
    return plan(
        scene,
        setup.path.build(scene, setup.rig.exposure_s),
        setup.masks(),
        setup.rig,
        setup.effects,
        tolerance_dn=setup.plan.tolerance_dn if tolerance_dn is None else tolerance_dn,
        on=setup.plan.on,
        off=setup.plan.off,
        seed=setup.seed,
        exact=ExactRenderer() if rays else None,
    )


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


def _share(seconds: float, decided: "Plan") -> str:
    return f"{100 * seconds / max(decided.seconds, 1e-12):.1f} %"
