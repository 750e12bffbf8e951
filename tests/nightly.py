"""What `make nightly` runs and a commit does not: most of a family whose members are alike, and what takes long.

A test says so itself (`but`, `but_one_of_each`, `NIGHTLY`), or stands in `nightly.toml`, with what runs in its stead.
"""

import tomllib
from collections import Counter
from collections.abc import Callable, Hashable, Iterable
from pathlib import Path
from typing import Any

import pytest

NIGHTLY = pytest.mark.nightly


def but(kept: int, values: Iterable[Any]) -> list[Any]:
    """Return cases of which the first few run with each commit, and the others by night."""
    return [value if number < kept else pytest.param(value, marks=NIGHTLY) for number, value in enumerate(values)]


def but_one_of_each(family: Callable[[Any], Hashable], values: Iterable[Any]) -> list[Any]:
    """Return cases of which the first of each family runs with each commit, and the others by night."""
    seen: set[Hashable] = set()
    cases = []
    for value in values:
        cases.append(pytest.param(value, marks=NIGHTLY) if family(value) in seen else value)
        seen.add(family(value))
    return cases


def listed() -> dict[str, int]:
    """Read the list: tests, or single cases of them, and how many cases of each run with every commit."""
    text = Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
    return {test: group.get("keep", 0) for group in tomllib.loads(text)["nightly"] for test in group["tests"]}


def by_night(names: Iterable[str], keep: dict[str, int]) -> list[bool]:
    """Tell which of these run by night only.

    Args:
        names: Of collected tests, in their order, as pytest prints them.
        keep: What `listed` returns.
    """
    seen: Counter[str] = Counter()
    answers = []
    for name in names:
        # pytest writes what is not ASCII as it is escaped in a string.
        plain = name.encode("latin-1", "backslashreplace").decode("unicode_escape") if "\\x" in name else name
        test = plain.partition("[")[0]
        answers.append(plain in keep or (test in keep and seen[test] >= keep[test]))
        seen[test] += 1
    return answers
