"""The modules and stages of benchmarks are found by their names, which nothing else would miss."""

import importlib

import pytest

from tests.benchmarks import profile, sizes
from tests.benchmarks.__main__ import BENCHMARKS


@pytest.mark.parametrize("name", BENCHMARKS)
def test_each_benchmark_can_be_started(name):
    assert callable(importlib.import_module(f"tests.benchmarks.{name}").run)


@pytest.mark.parametrize(("owner", "name"), [stage[1:] for stage in (*profile.PARTS, *sizes.STAGES)])
def test_what_a_benchmark_times_is_there(owner, name):
    assert callable(getattr(owner, name))
