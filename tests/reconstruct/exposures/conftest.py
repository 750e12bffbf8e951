"""Exposures of one room."""

import pytest

from gs2ci.reconstruct.exposures.tie import tie
from tests.reconstruct.exposures.rooms import PLACES, UNITS, exposure


@pytest.fixture(scope="session")
def four():
    """Four exposures of one room, each in its own unit, with noise of 2 %."""
    return [
        exposure(f"shot {k}", at, unit=unit, noise=0.02) for k, (at, unit) in enumerate(zip(PLACES, UNITS, strict=True))
    ]


@pytest.fixture(scope="session")
def four_tied(four):
    return tie(four)
