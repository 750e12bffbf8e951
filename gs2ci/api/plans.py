"""The effects and the sampling that a simulation needs, and why: `plan`, `explain`.

Not here: the computation (`gs2ci_sims.planner`, `explaining`), a capture's plan (`rigs`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gs2ci.api.options import check_number, every
from gs2ci.core.errors import InputError

if TYPE_CHECKING:
    from gs2ci_sims.explaining import Explanation
    from gs2ci_sims.simulation_plan import Plan


def plan(rig: str | Path, tolerance_dn: float | None = None, *, rays: bool = False) -> "Plan":
    """Decide which physical effects a simulated exposure must include, and why; nothing is exposed.

    Args:
        rig: The rig file (TOML) of a simulated bench or of a simulation alone (docs/simulation.md).
        tolerance_dn: Largest total error of the readings, DN rms; by default the rig file's.
        rays: Include the error of the rasteriser, and render Gaussians ray by ray if it is too large.

    Returns:
        Bound, decision, reason, sampling and cost of every effect.

    Raises:
        InputError: The file cannot be read, describes a bench of real devices, or a simulated bench with `rays`.

    Example:
        >>> decided = gs2ci.plan("rig.toml", tolerance_dn=2.0)
        >>> decided.tolerance_dn, decided.views > 0
        (2.0, True)
    """
    check_number("--tolerance-dn", tolerance_dn, above=0, remedy="leave --tolerance-dn out for the rig file's number")
    from gs2ci.core.config import read_toml

    rig = Path(rig)
    return foreseen(rig, read_toml(rig)[0], tolerance_dn, rays=rays)()


def explain(decided: "Plan | str | Path", effects: Sequence[str] = ("all",)) -> "tuple[Explanation, ...]":
    """Derive the bounds of a plan's effects step by step, with this rig's numbers.

    Args:
        decided: A plan, or the rig file to plan.
        effects: Names of effects, or "all".

    Returns:
        Law, steps with their values, and verdict of each, in physical order.

    Raises:
        InputError: The rig has no such effect, or as `plan`.

    Example:
        >>> (found,) = gs2ci.explain("rig.toml", ["shot_noise"])
        >>> len(found.steps) > 0, found.verdict != ""
        (True, True)
    """
    from gs2ci_sims.explaining import explain as explained

    return explained(plan(decided) if isinstance(decided, str | Path) else decided, every(effects))


def foreseen(
    rig: Path, tables: Mapping[str, Any], tolerance_dn: float | None = None, *, rays: bool = False
) -> "Callable[[], Plan]":
    """Read the tables of a rig file at once; return the function that plans.

    Arguments and errors as `plan`; `tables` are those of the file, or like them.
    """
    from gs2ci.rig.config import describes_simulation

    return (_simulation if describes_simulation(tables) else _bench)(rig, tables, tolerance_dn, rays)


def _bench(rig: Path, tables: Mapping[str, Any], tolerance_dn: float | None, rays: bool) -> "Callable[[], Plan]":
    from gs2ci.rig.config import rig_from_tables
    from gs2ci.rig.foreseen import foreseen_plan
    from gs2ci.rig.opening import Rig

    if rays:
        raise InputError(
            f"--rays for the bench of {rig}", allowed="the rig file of a simulation alone", remedy="leave --rays out"
        )
    bench = Rig(rig_from_tables(tables, rig), "", rig.parent)
    return lambda: foreseen_plan(bench, tolerance_dn)


def _simulation(rig: Path, tables: Mapping[str, Any], tolerance_dn: float | None, rays: bool) -> "Callable[[], Plan]":
    from gs2ci_sims import planner
    from gs2ci_sims.exact import ExactRenderer
    from gs2ci_sims.rig_file import setup_from_tables
    from gs2ci_sims.simulation_plan import SimulationTask

    setup = setup_from_tables(tables)

    def planned() -> "Plan":
        scene = setup.scene.build()
        path = setup.path.build(scene, setup.rig.exposure_s)
        task = SimulationTask(scene, path, setup.masks(), setup.rig, setup.effects, setup.seed)
        choice = setup.plan if tolerance_dn is None else replace(setup.plan, tolerance_dn=tolerance_dn)
        return planner.plan(task, choice, exact=ExactRenderer() if rays else None)

    return planned
