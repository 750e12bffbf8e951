"""What `make nightly` runs and a commit does not: most of a family whose members are alike, and what takes minutes."""

from collections.abc import Callable, Hashable, Iterable
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
