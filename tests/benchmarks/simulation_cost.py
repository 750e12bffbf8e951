"""Cost and gain of a plan, compared with a full simulation of its tolerance, and with all effects and its own sampling.

Rigs are those of `sims/gs2ci_sims/rigs`, six of them once more with masks that cancel or align, one that looks at a
mesh, and four with dear effects added that are there but too small to matter ("idle"). Per rig, three simulations are
timed in turns in one process, each the best of several: the plan (planning and preview included), (a) everything
(views doubled until the readings change by less than the tolerance; all rounds, and the last one by its share of the
views), and (b) all effects of the rig with the moments that the plan chose, which nobody had to plan. Times are the
processor's, all threads together; the last columns are times over the plan's. `GS2CI_SIZE` ("96x128") asks for larger
pictures than the rig files do, `GS2CI_CASES` for some of the cases. How far plans are off: `plan_deviation`.
"""

import os
import time
from collections.abc import Callable
from typing import Any

from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.radiance import Renderer
from tests.benchmarks.simulation_cases import SimulationCase, simulation_cases

SIZE = tuple(int(side) for side in os.environ.get("GS2CI_SIZE", "").split("x") if side)
TURNS = 3
# No further turn is begun after this long.
REPEAT_UNTIL_S = 5.0


def _seconds(function: Callable[[], Any]) -> tuple[float, Any]:
    """Return the processor's time, over all threads, that a call takes, and what it returns."""
    began_s = time.process_time()
    result = function()
    return time.process_time() - began_s, result


def _row(case: SimulationCase) -> None:
    bench = case.bench(0, SIZE or None)
    decided, _ = bench.planned()  # compiles
    blur = [effect for effect in decided.effects if isinstance(effect, MotionBlur)]
    everything = (*(effect for effect in bench.effects if not isinstance(effect, MotionBlur)), *blur)
    plans: list[float] = []
    rounds: list[float] = []
    alls: list[float] = []
    # In turns: what else the machine does then counts for all three alike.
    while len(plans) < TURNS and sum(plans) + sum(rounds) + sum(alls) < REPEAT_UNTIL_S:
        plans.append(_seconds(bench.planned)[0])
        seconds, same = _seconds(lambda: bench.everything(bench.tolerance_dn))
        rounds.append(seconds)
        alls.append(_seconds(lambda: bench.simulate(everything, Renderer()))[0])
    plan_s, rounds_s, all_s = min(plans), min(rounds), min(alls)
    # Rounds have 1, 2, 4, ... parts per mask.
    last_s = rounds_s * same.parts / (2 * same.parts - 1)
    simulated = sum(decision.simulated for decision in decided.decisions)
    print(
        f"| {case.label} | {simulated} of {len(decided.decisions)} | {decided.views} | {decided.error_dn:.3f} "
        f"| {plan_s:.3f} | {same.views} | {last_s:.3f} | {last_s / plan_s:.2f}x | {rounds_s / plan_s:.1f}x "
        f"| {all_s / plan_s:.2f}x |",
        flush=True,
    )


def run() -> None:
    """Print a table, a row per case."""
    print("| case | effects | views | bound, DN | plan, s | views (a) | (a), s | (a) | (a), all | (b) |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for case in simulation_cases(meshes=("04_slow_stage",)):
        _row(case)
