"""Are disturbed sweeps found? Captures with random halts, jumps, wrong speeds and late starts; and undisturbed ones.

    python -m tests.benchmarks disturbed_sweeps

Each shot of a capture on the simulated bench is swept once with a disturbance that the stage's counter or encoder sees;
a disturbance counts if it moves the camera, in the middle of a mask, by more than 3 times the error that the capture
states for its positions. It is *found* if the capture says so (the shot is then taken again, or the capture ends with a
typed error), *measured* if the positions that are stored are right to within 3 times that error, and *missed* if they
are not. Undisturbed sweeps must pass; how far their stored positions are from the truth is printed.

A motor that loses steps on a stage that counts its own steps is not among them: nothing on the line tells of it.
"""

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gs2ci.rig.opening import Rig
from gs2ci.rig.recording import prepare
from gs2ci.rig.simulated import build_bench
from gs2ci_drivers.acquisition import Taken, capture
from gs2ci_drivers.failures import DriverError
from gs2ci_sims.world import Exposure
from tests.system.conftest import HEIGHT, WIDTH, StripedLight, small_table

SHOTS = 20
TIMES = 3.0
KINDS: dict[str, Callable[[np.random.Generator], tuple[float, dict[str, float]]]] = {
    "stall": lambda rng: (rng.uniform(0.05, 0.9), {"pause_s": rng.uniform(0.005, 0.15)}),
    "slip": lambda rng: (rng.uniform(0.05, 0.9), {"jump_mm": rng.choice([-1, 1]) * rng.uniform(0.05, 0.6)}),
    "slower": lambda rng: (rng.uniform(0.0, 0.7), {"speed_factor": rng.uniform(0.3, 0.95)}),
    "faster": lambda rng: (rng.uniform(0.0, 0.7), {"speed_factor": rng.uniform(1.05, 2.0)}),
    "late": lambda rng: (0.0, {"pause_s": rng.uniform(0.005, 0.4)}),
}


class Draws:
    """Captures on one bench, each sweep disturbed once.

    Args:
        stage: Kind of the stage.
        disturbance: Draws when and how; None leaves the sweeps undisturbed.
        rng: Of the draws.
    """

    def __init__(self, stage: str, disturbance: Any, rng: np.random.Generator) -> None:
        table = small_table(
            modulator={"kind": "scpi"},
            stage={"kind": stage},
            capture={"shots": SHOTS, "retries": 1},
        )
        self.bench = build_bench(table, StripedLight((300 - HEIGHT) // 2, (400 - WIDTH) // 2))
        self.devices = Rig(table, "small", Path(), self.bench).open()
        prepared = prepare(Rig(table, "small", Path(), self.bench), self.devices)
        self.plan = replace(prepared.plan, settings=replace(prepared.plan.settings, shots=SHOTS))
        self.found: Counter[str] = Counter()
        self.errors_mm: list[float] = []
        self._disturbance, self._rng = disturbance, rng
        self._fresh, self._stated_mm, self._size_mm = True, 0.0, 0.0
        self._begin_sweep = self.devices.stage.begin_sweep  # type: ignore[union-attr]
        self.devices.stage.begin_sweep = self.begin_sweep  # type: ignore[union-attr, method-assign]

    def begin_sweep(self, sweep: Any) -> None:
        """Begin a sweep, disturbed if it is the first attempt of its shot."""
        if not self._fresh:
            self._judge("found")
        elif self._disturbance is not None:
            share, how = self._disturbance(self._rng)
            self.bench.stage.disturbances.add(share, **how)
        self._fresh = False
        self._begin_sweep(sweep)

    def run(self) -> None:
        """Take some shots."""
        self._fresh = True
        try:
            capture(self.devices, self.plan, self._deliver)
        except DriverError as error:
            if error.device != "stage":
                raise
            self._judge(f"found ({type(error).__name__})")
            self.devices.stage.stop()  # type: ignore[union-attr]

    def _positions_mm(self) -> np.ndarray:
        exposure: Exposure = self.bench.world.exposures[-1]
        shown = [mask for mask in exposure.masks if mask.end_s - mask.start_s > 1e-4]
        middles_s = [(mask.start_s + mask.end_s) / 2 for mask in shown]
        return np.array([self.bench.stage.positions_mm_at(when_s)["x"] for when_s in middles_s])

    def _judge(self, outcome: str) -> None:
        """Count what became of the last exposure, if it was disturbed enough."""
        true_mm = self._positions_mm()
        middles = np.arange(len(true_mm))
        sweep = self.plan.sweep
        assert sweep is not None
        step_mm = sweep.speed_mm_s * self.plan.sequence.exposure_s
        # From the first position that was right, at the planned speed.
        size_mm = float(np.abs(true_mm - (sweep.from_mm + step_mm * (middles + 0.5))).max())
        self.found[outcome if size_mm > TIMES * self._stated_mm else "too small to count"] += 1

    def _deliver(self, taken: Taken) -> None:
        assert taken.stage_mm is not None
        assert taken.stage_error_mm is not None
        self._stated_mm = taken.stage_error_mm
        error_mm = float(np.abs(taken.stage_mm[:, 0] - self._positions_mm()).max())
        if taken.attempts == 1:
            self.errors_mm.append(error_mm)
            self._judge("measured" if error_mm <= TIMES * taken.stage_error_mm else "MISSED")
        self._fresh = True


def run(draws: int = 200, undisturbed: int = 500) -> None:
    """Print what became of the draws."""
    for stage in ("zaber", "grbl"):
        rng = np.random.default_rng(0)
        quiet = Draws(stage, None, rng)
        while sum(quiet.found.values()) < undisturbed:
            quiet.run()
        alarms = sum(count for outcome, count in quiet.found.items() if outcome.startswith("found"))
        worst = max(quiet.errors_mm)
        count = sum(quiet.found.values())
        print(f"{stage:6s} undisturbed: {count} sweeps, {alarms} false alarms; stored positions off by", end=" ")
        print(f"at most {worst:.4f} mm, stated {quiet._stated_mm:.4f} mm", flush=True)
        for kind, disturbance in KINDS.items():
            disturbed = Draws(stage, disturbance, rng)
            disturbed._stated_mm = quiet._stated_mm
            while sum(n for outcome, n in disturbed.found.items() if outcome != "too small to count") < draws:
                disturbed.run()
            told = ", ".join(f"{n} {outcome}" for outcome, n in sorted(disturbed.found.items()))
            print(f"{stage:6s} {kind:7s} {told}", flush=True)


if __name__ == "__main__":
    run(*(int(text) for text in sys.argv[1:]))
