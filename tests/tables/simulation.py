"""The cost of accuracy in simulations: planned and full simulations, rig by rig.

Here: the cases, from calm to violent, and the work of one cell of `python -m tests.tables simulate`. Not here:
plans (`gs2ci_sims`), the full simulation (`tests.sims.brute_force`), the table (`catalogue`).
"""

import time
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Final

from gs2ci.core.arrays import F32, F64
from gs2ci.core.errors import InputError
from gs2ci.evaluate.tradeoff.store import Row
from gs2ci_sims.exposure import integrate, read_out
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.path import CameraPath
from gs2ci_sims.planner import plan
from gs2ci_sims.rig_file import Setup
from gs2ci_sims.rigs import library
from gs2ci_sims.scene import Scene
from gs2ci_sims.simulation_plan import Plan, PlanChoice, SimulationTask
from tests.sims.brute_force import BruteForce, deviation_dn, simulate_everything
from tests.sims.rig_files import read_rig_file
from tests.tables.cases import Case

TOLERANCES_DN: Final = (0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 5.0)
EVERYTHING: Final = "everything"
# Fast runs are worth repeating: the least of so many counts, but none is begun after this long.
_REPEATS: Final = 3
_REPEAT_UNTIL_S: Final = 1.0


def rig_cases(folder: Path | None) -> tuple[Case, ...]:
    """Return a case for each rig file of a folder, or for the simulator's own rig files.

    Raises:
        InputError: There are none.
    """
    files = sorted(folder.glob("*.toml")) if folder else library()
    if not files:
        raise InputError(f"{folder} holds no .toml file", remedy="name a folder of rig files, or leave --data out")
    return tuple(Case(file.stem, file=str(file.resolve())) for file in files)


def simulate_rig(file: str, tolerance_dn: float | None, seed: int) -> Row:
    """Simulate a rig within a tolerance, planning included, or in full; return its time and its deviation.

    Args:
        file: The rig file; its own seed and tolerance are not read.
        tolerance_dn: Of the plan, DN rms; None simulates everything.
        seed: Of masks and all draws.

    Raises:
        Gs2ciError: The file cannot be read, or the full simulation does not settle.
    """
    brute, everything_s = _everything(file, seed)
    if tolerance_dn is None:
        effects = len(brute.chain.effects)
        return {"seconds": everything_s, "off_dn": 0.0, "bound_dn": 0.0, "views": brute.views, "effects": effects}
    bench = _Bench.of(file, seed)
    seconds: list[float] = []
    while len(seconds) < _REPEATS and sum(seconds) < _REPEAT_UNTIL_S:
        began_s = time.perf_counter()
        decided, photons = bench.simulate(tolerance_dn)
        seconds.append(time.perf_counter() - began_s)
    return {
        "seconds": min(seconds),
        "off_dn": deviation_dn(brute, photons, decided.effects, seed),
        "bound_dn": decided.error_dn,
        "views": decided.views,
        "effects": sum(decision.simulated for decision in decided.decisions),
        "faster": everything_s / min(seconds),
        "faster_than_all_rounds": brute.all_seconds / min(seconds),
    }


@dataclass(frozen=True)
class _Bench:
    """A simulated rig built from a rig file."""

    setup: Setup
    scene: Scene
    path: CameraPath
    masks: F32

    @classmethod
    def of(cls, file: str, seed: int) -> "_Bench":
        setup = replace(read_rig_file(Path(file)), seed=seed)
        scene = setup.scene.build()
        return cls(setup, scene, setup.path.build(scene, setup.rig.exposure_s), setup.masks())

    def simulate(self, tolerance_dn: float) -> tuple[Plan, F64]:
        """Plan and expose once; return the plan, and the mean photons in each pixel, [H, W, 3]."""
        rig, seed = self.setup.rig, self.setup.seed
        task = SimulationTask(self.scene, self.path, self.masks, rig, self.setup.effects, seed)
        decided = plan(task, PlanChoice(tolerance_dn))
        chain = EffectChain(decided.effects, seed, rig)
        photons = integrate(self.scene, self.path, self.masks, chain)
        read_out(photons, chain)
        return decided, photons


@lru_cache(maxsize=1)
def _everything(file: str, seed: int) -> tuple[BruteForce, float]:
    """Simulate a rig in full, once for all its tolerances; also return the seconds of its last round and readout."""
    bench = _Bench.of(file, seed)
    rig, effects = bench.setup.rig, bench.setup.effects
    bench.simulate(TOLERANCES_DN[-1])  # compiles
    brute = simulate_everything(bench.scene, bench.path, bench.masks, rig, effects, seed=seed)
    began_s = time.perf_counter()
    read_out(brute.photons, brute.chain)
    return brute, brute.seconds + time.perf_counter() - began_s
