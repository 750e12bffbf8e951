"""Random interleavings of moves, stops, kills, reconnections, holds, resets, restarts, homings: 10,000 of each stage.

    python -m tests.benchmarks stage_interleavings

In none may anything move after a stop has returned, or a wrong position be trusted (`tests/drivers/interleavings.py`).
"""

import sys
import time
from collections import Counter

from hypothesis.stateful import run_state_machine_as_test

from tests.drivers.interleavings import STAGES, STEPS, Interleaving, limits

COUNT = 10_000


def _counted(stage: type[Interleaving], done: Counter[str]) -> type[Interleaving]:
    """Return a machine that counts what it does."""

    class Counted(stage):  # type: ignore[misc, valid-type]
        def __init__(self) -> None:
            super().__init__()
            done["interleavings"] += 1

        def true_mm(self) -> dict[str, float]:
            done["looks at the carriage"] += 1
            return super().true_mm()  # type: ignore[no-any-return]

    return Counted


def run(count: int = COUNT, *names: str) -> None:
    """Print what was tried and what was found, of all stages or of some."""
    print(f"{count} interleavings of up to {STEPS} steps each; seconds are those of the processor")
    for name in names or STAGES:
        stage = STAGES[name]
        done: Counter[str] = Counter()
        begin_s = time.process_time()
        try:
            run_state_machine_as_test(_counted(stage, done), settings=limits(count, derandomize=False, database=None))
            found = "none broke a promise"
        except AssertionError as error:
            found = f"BROKEN: {error}"
            print("\n".join(getattr(error, "__notes__", [])))
        told = ", ".join(f"{n} {what}" for what, n in done.items())
        print(f"{name:40s} {told}, {time.process_time() - begin_s:.0f} s: {found}", flush=True)


if __name__ == "__main__":
    run(int(sys.argv[1]) if len(sys.argv) > 1 else COUNT, *sys.argv[2:])
