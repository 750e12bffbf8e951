"""The hard cases in a quick version: every case that is marked for it, small and short, run end to end and judged.

One of each family runs with every commit, all of them by night.

The whole suite, larger and longer, is `make stability`.
"""

import pytest

from tests.nightly import but_one_of_each
from tests.stability.benches import QUICK
from tests.stability.cases import CASES
from tests.stability.judge import judge

pytestmark = pytest.mark.slow

QUICK_CASES = [case for case in CASES if case.quick]


@pytest.mark.parametrize("case", but_one_of_each(lambda case: case.family, QUICK_CASES), ids=lambda case: case.title)
def test_a_hard_case_ends_well(case):
    assert judge(case, QUICK).problems == ()


def test_every_case_has_a_title_of_its_own():
    assert len({case.title for case in CASES}) == len(CASES)


def test_every_family_is_represented_among_the_quick_cases():
    assert {case.family for case in QUICK_CASES} == {case.family for case in CASES}
