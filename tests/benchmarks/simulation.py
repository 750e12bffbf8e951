"""What accuracy costs the simulator: plans against the simulation of everything, from calm to violent rigs.

Run `python -m tests.benchmarks.simulation`; `--plot FILE.png` also draws time against tolerance. Each case is a rig
file beside this one, in `rigs/`. Times are medians of a few runs on one machine: read the ratios.
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import matplotlib as mpl
import numpy as np
from rich.console import Console
from rich.table import Table

from gs2ci_sims.brute_force import BruteForce, deviation_dn, simulate_everything
from gs2ci_sims.exposure import integrate, read_out
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.planner import Plan, plan
from gs2ci_sims.rig_file import Setup, read_rig_file

RIGS = Path(__file__).parent / "rigs"
TOLERANCES_DN = (0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 5.0)
REPEATS = 3
# Slow plans are not timed again.
REPEAT_UNTIL_S = 1.0


@dataclass(frozen=True)
class Row:
    """One plan against everything: what it took, planning included, and by how much it is off."""

    tolerance_dn: float
    plan: Plan
    seconds: float
    deviation_dn: float


@dataclass(frozen=True)
class Case:
    """One rig file's results."""

    name: str
    brute: BruteForce
    brute_seconds: float
    rows: tuple[Row, ...]


def measure(path: Path, tolerances: tuple[float, ...] = TOLERANCES_DN, repeats: int = REPEATS) -> Case:
    """Simulate everything once, and plans for each tolerance."""
    setup = read_rig_file(path)
    scene = setup.scene.build()
    camera = setup.path.build(scene, setup.rig.exposure_s)
    masks = setup.masks()
    brute = simulate_everything(scene, camera, masks, setup.rig, setup.effects, seed=setup.seed)
    started = time.perf_counter()
    read_out(brute.photons, brute.chain)
    brute_seconds = brute.seconds + time.perf_counter() - started
    rows = tuple(_row(setup, scene, camera, masks, brute, tolerance, repeats) for tolerance in tolerances)
    return Case(path.stem, brute, brute_seconds, rows)


def _row(setup: Setup, scene, camera, masks, brute: BruteForce, tolerance_dn: float, repeats: int) -> Row:
    seconds = []
    for _ in range(repeats):
        if sum(seconds) > REPEAT_UNTIL_S:
            break
        started = time.perf_counter()
        decided = plan(scene, camera, masks, setup.rig, setup.effects, tolerance_dn=tolerance_dn, seed=setup.seed)
        chain = EffectChain(decided.effects, setup.seed, setup.rig)
        light = integrate(scene, camera, masks, chain)
        read_out(light.photons, chain)
        seconds.append(time.perf_counter() - started)
    deviation = deviation_dn(brute, light.photons, decided.effects, setup.seed)
    return Row(tolerance_dn, decided, median(seconds), deviation)


def table(cases: list[Case], tolerance_dn: float) -> Table:
    """Lay out the results at one tolerance."""
    shown = Table(title=f"plans at {tolerance_dn} DN rms in total, against simulating everything")
    for column in (
        "case",
        "effects",
        "views",
        "off by, DN",
        "bound, DN",
        "time, s",
        "everything: views",
        "time, s",
        "faster",
        "than all rounds",
    ):
        shown.add_column(column, justify="left" if column == "case" else "right", no_wrap=True)
    for case in cases:
        row = next(row for row in case.rows if row.tolerance_dn == tolerance_dn)
        simulated = sum(decision.simulated for decision in row.plan.decisions)
        shown.add_row(
            case.name,
            f"{simulated} of {len(row.plan.decisions)}",
            f"{row.plan.views}",
            f"{row.deviation_dn:.3f}",
            f"{row.plan.error_dn:.3f}",
            f"{row.seconds:.3f}",
            f"{case.brute.views}",
            f"{case.brute_seconds:.3f}",
            f"{case.brute_seconds / row.seconds:.1f}x",
            f"{case.brute.all_seconds / row.seconds:.1f}x",
        )
    return shown


def trade_off(cases: list[Case]) -> Table:
    """Lay out time and deviation against tolerance."""
    shown = Table(title="seconds (DN off) by tolerance, DN rms")
    shown.add_column("case", no_wrap=True)
    for row in cases[0].rows:
        shown.add_column(f"{row.tolerance_dn:g}", justify="right", no_wrap=True)
    for case in cases:
        shown.add_row(case.name, *(f"{row.seconds:.3f} ({row.deviation_dn:.2f})" for row in case.rows))
    return shown


def draw(cases: list[Case], path: Path) -> None:
    """Draw time against tolerance, with the time that everything takes at the left."""
    mpl.use("Agg")
    from matplotlib import pyplot  # noqa: PLC0415

    figure, axes = pyplot.subplots(figsize=(8, 5), constrained_layout=True)
    colours = pyplot.get_cmap("viridis")(np.linspace(0, 0.95, len(cases)))
    for case, colour in zip(cases, colours, strict=True):
        tolerances = [row.tolerance_dn for row in case.rows]
        axes.plot(tolerances, [row.seconds for row in case.rows], "o-", color=colour, label=case.name, markersize=3)
        axes.plot([TOLERANCES_DN[0] * 0.6], [case.brute_seconds], "_", color=colour, markersize=12)
    axes.set(xscale="log", yscale="log", xlabel="tolerance, DN rms in total", ylabel="time, s (dashes: everything)")
    axes.legend(fontsize=7, ncols=2)
    figure.savefig(path)


def main() -> None:
    """Measure cases, print the tables, draw the plot if asked."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--plot", type=Path, help="where to draw time against tolerance")
    parser.add_argument("--only", default="", help="cases whose names contain this")
    arguments = parser.parse_args()
    run(arguments.only, arguments.plot)


def run(only: str = "", plot: Path | None = None) -> None:
    """Measure the cases whose names contain `only`, print the tables, draw the plot if asked."""
    console = Console(width=150)
    measure(min(RIGS.glob("*.toml")), (0.25,), 1)  # compiles
    cases = []
    for path in sorted(RIGS.glob("*.toml")):
        if only in path.stem:
            cases.append(measure(path))
            row = next(row for row in cases[-1].rows if row.tolerance_dn == 0.25)
            console.print(f"{path.stem}: {row.plan.summary()}", markup=False, highlight=False)
    console.print(table(cases, 0.25))
    console.print(trade_off(cases))
    if plot:
        draw(cases, plot)


if __name__ == "__main__":
    main()
