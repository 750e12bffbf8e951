"""Where scales of pictures begin and end."""

import numpy as np
import pytest

from gs2ci.evaluate.scales import error_ceiling, inverse_depth_limits, white_level


def test_single_glints_do_not_darken_a_measurement():
    measurement = np.full((100, 100, 1), 0.5, np.float32)
    measurement[0, :20] = 9
    assert white_level(measurement) == pytest.approx(0.5)


def test_a_black_measurement_is_not_divided_by_nothing():
    assert white_level(np.zeros((4, 4, 3), np.float32)) > 0


def test_single_wrong_depths_do_not_stretch_their_scale():
    inverse = np.concatenate([np.linspace(1, 2, 1000), [100.0]])
    low, high = inverse_depth_limits(inverse)
    assert 1 <= low < high <= 2


def test_one_depth_has_a_scale_around_it():
    low, high = inverse_depth_limits(np.full(50, 0.25))
    assert low < 0.25 < high


def test_small_errors_look_small():
    assert error_ceiling(np.full((8, 8), 1e-4)) == pytest.approx(0.02)
    assert error_ceiling(np.linspace(0, 1, 1001)) == pytest.approx(0.995)
