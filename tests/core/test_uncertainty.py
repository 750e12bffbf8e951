from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError, NumericsError
from gs2ci.core.uncertainty import Uncertainty

SHAPE = (2, 3, 4)


@pytest.fixture
def errors():
    maps = np.full(SHAPE, 0.1, np.float32)
    return Uncertainty(maps, maps, np.array([0.1, 0.2]), np.array([0.0, 0.01]))


def test_parts_that_fit_the_result_pass(errors):
    assert errors.check(SHAPE) is errors
    assert Uncertainty(errors.views).check(SHAPE).depth is None


@pytest.mark.parametrize("name", ["views", "depth", "positions", "rotations"])
def test_a_part_of_another_shape_is_refused_by_name(errors, name):
    with pytest.raises(InputError, match=f"standard errors of {name} have shape"):
        replace(errors, **{name: np.zeros((5,))}).check(SHAPE)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -0.1])
def test_a_number_that_is_no_standard_error_is_refused(errors, bad):
    wrong = errors.positions.copy()
    wrong[1] = bad
    with pytest.raises(NumericsError, match="standard errors of positions hold"):
        replace(errors, positions=wrong).check(SHAPE)
