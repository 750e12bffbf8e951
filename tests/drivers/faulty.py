"""Faults on a modulator's twin, one after another: what strikes where, and what must come of it. Not a test."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from gs2ci_drivers.failures import DriverError
from gs2ci_drivers.pattern_sequence import PatternSequence
from gs2ci_drivers.testing.modulator_bench import ModulatorBench


@dataclass(frozen=True)
class FaultCase:
    """A fault, where it strikes, and what must come of it.

    Args:
        fault: Its name, as the twin's list of faults has it.
        about: In which exchange it strikes; "" for any.
        error: What the driver raises; None where it rides the fault out.
        says: What the error says, as a regular expression.
        value: As the fault takes it: seconds, a code, ...
        times: How often it strikes.
        skip: How many such exchanges pass before.
        within_s: After how many seconds of the device's clock, uploads aside, the error has come.
    """

    fault: str
    about: str
    error: type[DriverError] | None
    says: str = ""
    value: float = 0.0
    times: int = 1
    skip: int = 0
    within_s: float = 12.0

    def __str__(self) -> str:
        return f"{self.fault} at {self.about or 'any'}"


def strike(
    bench: ModulatorBench[Any],
    case: FaultCase,
    sequence: PatternSequence,
    assert_shown: Callable[[list[Any]], None],
    repair: Callable[[], object] = lambda: None,
) -> None:
    """Show a sequence while a fault strikes; then, with the fault gone, show it again.

    Args:
        bench: The driver on its twin.
        case: The fault.
        sequence: What is shown.
        assert_shown: Asserts that all of it was.
        repair: Takes back what the fault left in the twin.
    """
    faults, clock = bench.twin.faults, bench.world.clock
    faults.inject(case.fault, about=case.about, value=case.value, times=case.times, skip=case.skip)
    begin_s = clock.now_s()
    if case.error is None:
        assert_shown(bench.run(sequence))
    else:
        with pytest.raises(case.error, match=f"(?s){bench.name}.*{case.says}") as caught:
            bench.run(sequence)
        assert caught.value.device == bench.name
        eta_s = bench.modulator.upload_eta_s(sequence) + sequence.duration_s if bench.twin.plugged else 5.0
        assert clock.now_s() - begin_s < case.within_s + eta_s
    assert faults.struck, "the fault never struck"
    faults.clear()
    repair()
    if not bench.twin.plugged:
        bench.reopen()
    bench.modulator.connect()
    bench.modulator.disarm()
    assert_shown(bench.run(sequence))
