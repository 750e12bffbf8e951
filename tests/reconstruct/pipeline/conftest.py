"""The measurement of the tests of the whole reconstruction, and its reconstruction with settings that are short."""

import pytest

from gs2ci.reconstruct.pipeline import reconstruct
from tests.reconstruct.pipeline.boards import SHORT, expose, wall_with_a_board


@pytest.fixture(scope="session")
def shot():
    return expose(wall_with_a_board())


@pytest.fixture(scope="session")
def found_soon(shot):
    return reconstruct(shot, SHORT)
