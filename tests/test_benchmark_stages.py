"""The stages that benchmarks time are found by their names, which nothing else would miss."""

import pytest

from tests.benchmarks import profile, sizes


@pytest.mark.parametrize(("owner", "name"), [stage[1:] for stage in (*profile.PARTS, *sizes.STAGES)])
def test_what_a_benchmark_times_is_there(owner, name):
    assert callable(getattr(owner, name))
