"""The modules and stages of benchmarks are found by their names, which nothing else would miss."""

import importlib

from tests.benchmarks import many_exposures, profile, sizes
from tests.benchmarks.__main__ import BENCHMARKS


def test_each_benchmark_can_be_started():
    modules = [importlib.import_module(f"tests.benchmarks.{name}") for name in BENCHMARKS]
    assert [module.__name__ for module in modules if not callable(getattr(module, "run", None))] == []


def test_what_a_benchmark_times_is_there():
    stages = [stage[1:] for stage in (*profile.PARTS, *sizes.STAGES, *many_exposures.STAGES)]
    assert [(owner, name) for owner, name in stages if not callable(getattr(owner, name, None))] == []
