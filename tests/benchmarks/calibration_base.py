"""Accuracy of dark-flat, sensor and timing: errors over random simulated benches, and the refusals of faulty ones.

python -m tests.benchmarks calibration_base
"""

from collections import defaultdict

import numpy as np

from gs2ci_calibration.bundle import Bundle
from gs2ci_calibration.procedures import PROCEDURES
from gs2ci_calibration.refusals import CalibrationError
from tests.bench_truth import opened
from tests.calibration.random_benches import SPOILED, compare, random_table, spoiled_table

BENCHES = 24
STEPS = ("dark-flat", "sensor", "timing")
FRAMES = 32


def run() -> None:
    found = defaultdict(list)
    for seed in range(BENCHES):
        with opened(random_table(seed, frames=FRAMES)) as (bench, truth):
            known = Bundle()
            for step in STEPS:
                section = PROCEDURES[step](bench, known)
                known = known.with_section(section)
                for one in compare(section, truth):
                    found[step, one.name].append(one)
    print(f"{BENCHES} random benches, {FRAMES} frames per stack; errors against the truth")
    heads = f"{'rms error':>11} {'worst':>11} {'rms rel.':>9} {'worst rel.':>10}  within 2 s.e."
    print(f"{'step':<10} {'estimate':<22} {heads}")
    for (step, name), ones in found.items():
        errors, values = np.array([one.error for one in ones]), np.array([one.value for one in ones])
        relative = errors / np.where(values == 0, np.inf, values)
        print(
            f"{step:<10} {name:<22} {np.sqrt(np.square(errors).mean()):>11.3g} {np.abs(errors).max():>11.3g} "
            f"{np.sqrt(np.square(relative).mean()):>9.2%} {np.abs(relative).max():>10.2%}"
            f"  {np.mean([one.within for one in ones]):.3f}"
        )
    print("\nspoiled benches")
    for what, (step, reason, _) in SPOILED.items():
        print(f"{what:<22} expected {step}: {reason.value:<18} {_refusal(what, step)}")


def _refusal(what: str, last: str) -> str:
    known = Bundle()
    with opened(spoiled_table(what, 1)) as (bench, _):
        try:
            for step in STEPS[: STEPS.index(last) + 1]:
                known = known.with_section(PROCEDURES[step](bench, known))
        except CalibrationError as error:
            return f"refused by {error.step}: {error.reason.value}"
    return "NOT REFUSED"
