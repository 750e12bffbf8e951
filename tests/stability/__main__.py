"""`make stability`: run every hard case in full, and write the outcomes into the docs.

    python -m tests.stability                    all cases; writes docs/stability.md and docs/images/stability.png
    python -m tests.stability --only saturation  those whose titles contain this; prints only
    python -m tests.stability --jobs 4           in this number of processes
    python -m tests.stability --record cases.jsonl   record outcomes in this file; a second run continues from them
    python -m tests.stability --random 100       instead, measurements of random form (`random_forms.py`); prints only
    python -m tests.stability --random 100 --from 500   others

Exits with 1 if any case has a problem: a result that is not finite, bounded, honest, or worse than the decode alone.
"""

import argparse
import os
import sys
from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter

from tests.processes import as_they_end
from tests.stability import random_forms
from tests.stability.cases import CASES, Case
from tests.stability.judge import Outcome, judge_by_number
from tests.stability.page import write_page

DOCS = Path(__file__).parents[2] / "docs"


@dataclass(frozen=True)
class Kept:
    """One line of a record: a case by its title, and what came of it."""

    title: str
    outcome: Outcome


_KEPT = TypeAdapter(Kept)


def judge_all(numbers: list[int], jobs: int, record: Path | None = None) -> dict[int, Outcome]:
    """Judge cases and say how each fared; those that the record holds are taken from there."""
    outcomes = {} if record is None else kept_in(record)
    outcomes = {number: outcome for number, outcome in outcomes.items() if number in numbers}
    missing = [number for number in numbers if number not in outcomes]
    for number, outcome, seconds in as_they_end(judge_by_number, missing, jobs):
        outcomes[number] = outcome
        case = CASES[number]
        print(line_of(case, outcome, seconds), flush=True)
        if record is not None:
            with record.open("ab") as file:
                file.write(_KEPT.dump_json(Kept(case.title, outcome)) + b"\n")
    return {number: outcomes[number] for number in numbers}


def kept_in(record: Path) -> dict[int, Outcome]:
    """Return the outcomes of a record by the numbers that their cases have now; cut off an unfinished last line."""
    if not record.exists():
        return {}
    numbers = {case.title: number for number, case in enumerate(CASES)}
    whole, _, unfinished = record.read_bytes().rpartition(b"\n")
    if unfinished:
        record.write_bytes(whole + b"\n" if whole else b"")
    kept = [_KEPT.validate_json(line) for line in whole.splitlines()]
    return {numbers[k.title]: k.outcome for k in kept if k.title in numbers}


def line_of(case: Case, outcome: Outcome, seconds: float) -> str:
    """Say in a line how a case fared."""
    loss = "" if outcome.loss_db is None else f"{outcome.loss_db:+.1f} dB lost"
    problems = f"  PROBLEM: {'; '.join(outcome.problems)}" if outcome.problems else ""
    return f"{outcome.grade:8} {loss:13} {seconds:5.1f} s  {case.title}{problems}"


def judge_random(seeds: range, jobs: int) -> int:
    """Judge measurements of random form and say how each fared; return 1 if the result of any is wrong."""
    bad = 0
    for line, problem in as_they_end(random_forms.judge, seeds, jobs):
        bad += problem is not None
        print(line if problem is None else f"{line}\n{problem}", flush=True)
    print(f"{len(seeds)} measurements of random form, {bad} with problems")
    return int(bad > 0)


def main() -> int:
    """Run the suite."""
    parser = argparse.ArgumentParser(prog="python -m tests.stability", description="Run the hard cases.")
    parser.add_argument("--only", default="", help="cases whose titles contain this; writes no page")
    parser.add_argument("--jobs", type=int, default=max(1, (os.cpu_count() or 2) // 2), help="processes")
    parser.add_argument("--record", type=Path, help="keep outcomes in this file, and go on from those it holds")
    parser.add_argument("--random", type=int, default=0, help="instead, so many measurements of random form")
    parser.add_argument("--from", type=int, default=0, dest="first", help="the first seed of these")
    arguments = parser.parse_args()
    if arguments.random:
        return judge_random(range(arguments.first, arguments.first + arguments.random), arguments.jobs)
    numbers = [number for number, case in enumerate(CASES) if arguments.only in case.title]
    outcomes = judge_all(numbers, arguments.jobs, arguments.record)
    if not arguments.only:
        written = write_page(DOCS, [(CASES[number], outcome) for number, outcome in outcomes.items()])
        print(f"wrote {written}")
    bad = sum(bool(outcome.problems) for outcome in outcomes.values())
    print(f"{len(outcomes)} cases, {bad} with problems")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
