"""The contracts that every driver keeps, as tests that can be run on a driver of another package.

modulator.py        the modulator's contract; modulator_bench.py, a driver on its twin
stage.py            the stage's

A plug-in's test module imports the tests and defines the fixtures that they need:

    from gs2ci_drivers.testing.modulator import *

    @pytest.fixture
    def bench():
        ...

They need pytest, which gs2ci does not install by itself. Each module is named before it is imported, so that pytest
explains the assertions in it.
"""

import pytest

pytest.register_assert_rewrite("gs2ci_drivers.testing.modulator", "gs2ci_drivers.testing.stage")
