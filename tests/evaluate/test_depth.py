import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.evaluate.depth import depth_errors


def ramp(count=2, height=4, width=5):
    return np.linspace(1, 3, count * height * width, dtype=np.float32).reshape(count, height, width)


def test_depth_in_another_unit_has_no_error():
    found = depth_errors(2.5 * ramp(), ramp())
    assert found.scale == pytest.approx(0.4)
    assert found.abs_rel == pytest.approx(0, abs=1e-6)
    assert found.rms == pytest.approx(0, abs=1e-6)
    assert (found.close_share, found.known_share) == (1, 1)


def test_errors_are_those_computed_by_hand():
    truth = np.full((1, 1, 5), 2, np.float32)
    estimate = np.array([[[2, 2, 2, 3, 1]]], np.float32)
    found = depth_errors(estimate, truth)
    assert found.abs_rel == pytest.approx((0.5 + 0.5) / 5)
    assert found.rms == pytest.approx(np.sqrt(2 / 5))
    assert found.close_share == pytest.approx(3 / 5)


@pytest.mark.parametrize("unknown", [0.0, -1.0, np.nan, np.inf])
def test_pixels_that_either_does_not_know_do_not_count(unknown):
    truth, estimate = ramp(), ramp()
    truth[0, 0, 0] = unknown
    estimate[1, 1] = unknown
    found = depth_errors(estimate, truth)
    assert found.abs_rel == pytest.approx(0, abs=1e-6)
    assert found.known_share == pytest.approx(34 / 39)


def test_where_nothing_is_known_to_both_there_is_no_error():
    assert depth_errors(np.zeros((1, 3, 3), np.float32), np.ones((1, 3, 3), np.float32)) is None


def test_one_true_map_serves_one_view_and_other_shapes_are_refused():
    assert depth_errors(ramp(1), ramp(1)[0]) is not None
    with pytest.raises(InputError, match="true depth"):
        depth_errors(ramp(2), ramp(1))
