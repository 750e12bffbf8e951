"""`make stability`: run every hard case at leisure, and write what came of them into the docs.

    python -m tests.stability                    all cases; writes docs/stability.md and docs/images/stability.png
    python -m tests.stability --only saturation  those whose titles contain this; prints only
    python -m tests.stability --jobs 4           in so many processes

Exits with 1 if any case has a problem: a result that is not finite, bounded, honest, or worse than the decode alone.
"""

import argparse
import os
import sys
from pathlib import Path

from tests.processes import side_by_side
from tests.stability.cases import CASES, Case
from tests.stability.judge import Outcome, judge_by_number
from tests.stability.page import write_page

DOCS = Path(__file__).parents[2] / "docs"


def judge_all(numbers: list[int], jobs: int) -> dict[int, Outcome]:
    """Judge cases and say how each fared."""
    outcomes = {}
    for number, outcome, seconds in side_by_side(judge_by_number, numbers, jobs):
        outcomes[number] = outcome
        print(line_of(CASES[number], outcome, seconds), flush=True)
    return outcomes


def line_of(case: Case, outcome: Outcome, seconds: float) -> str:
    """Say in a line how a case fared."""
    loss = "" if outcome.loss_db is None else f"{outcome.loss_db:+.1f} dB lost"
    problems = f"  PROBLEM: {'; '.join(outcome.problems)}" if outcome.problems else ""
    return f"{outcome.grade:8} {loss:13} {seconds:5.1f} s  {case.title}{problems}"


def main() -> int:
    """Run the suite."""
    parser = argparse.ArgumentParser(prog="python -m tests.stability", description="Run the hard cases.")
    parser.add_argument("--only", default="", help="cases whose titles contain this; writes no page")
    parser.add_argument("--jobs", type=int, default=max(1, (os.cpu_count() or 2) // 2), help="processes")
    arguments = parser.parse_args()
    numbers = [number for number, case in enumerate(CASES) if arguments.only in case.title]
    outcomes = judge_all(numbers, arguments.jobs)
    if not arguments.only:
        written = write_page(DOCS, [(CASES[number], outcome) for number, outcome in outcomes.items()])
        print(f"wrote {written}")
    bad = sum(bool(outcome.problems) for outcome in outcomes.values())
    print(f"{len(outcomes)} cases, {bad} with problems")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
