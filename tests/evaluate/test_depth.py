import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.evaluate.depth import FAR_OFF_PX, depth_errors, inverse_depth_errors, parallax_of


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


def test_a_constant_in_inverse_depth_is_no_error_of_disparity():
    truth = ramp()
    shifted = (1 / (0.7 / truth + 0.1)).astype(np.float32)
    found = depth_errors(shifted, truth, parallax=20.0)
    assert found.median_px == pytest.approx(0, abs=1e-4)
    assert found.far_off_share == 0
    assert found.median_rel > 0.02
    assert found.rank == pytest.approx(1)


def test_single_pixels_far_off_are_counted_and_do_not_bend_the_fit():
    truth, estimate = ramp(4, 10, 10), ramp(4, 10, 10)
    estimate[0, :4] = 9.0
    found = depth_errors(estimate, truth, parallax=30.0)
    assert found.median_px < 0.05
    assert found.far_off_share == pytest.approx(0.1, abs=0.01)
    assert 30 * np.abs(1 / 9 - 1 / truth[0, :4]).min() > FAR_OFF_PX


def test_the_affine_fit_leaves_least_absolute_errors():
    rng = np.random.default_rng(0)
    true = rng.uniform(1, 4, 400)
    found = 1 / (1 / true + rng.normal(0, 0.02, 400) + 0.3 * (rng.random(400) < 0.1))
    left = inverse_depth_errors(found, true).sum()
    others = [
        np.abs(a / found + b - 1 / true).sum() for a in np.linspace(0.9, 1.1, 21) for b in np.linspace(-0.1, 0.1, 21)
    ]
    assert left <= min(others) * 1.001


def test_rank_is_negative_where_near_and_far_are_exchanged_and_open_on_a_plane():
    assert depth_errors(4 - ramp(), ramp()).rank == pytest.approx(-1)
    plane = np.full((1, 3, 4), 2, np.float32)
    assert depth_errors(plane, plane, parallax=5.0).rank is None


def test_a_plane_that_any_affine_fit_meets_has_no_error_in_px():
    plane = np.full((1, 3, 4), 2, np.float32)
    for estimate in (plane, ramp(1, 3, 4)):
        found = depth_errors(estimate, plane, parallax=5.0)
        assert found.median_px is found.far_off_share is None
    assert depth_errors(plane, ramp(1, 3, 4), parallax=20.0).far_off_share > 0.5


def test_depth_with_near_and_far_exchanged_is_as_far_off_as_none():
    truth = ramp()
    found = depth_errors((1 / (1.2 - 1 / truth)).astype(np.float32), truth, parallax=20.0)
    none = 20.0 * np.abs(1 / truth - np.median(1 / truth))
    assert found.rank == pytest.approx(-1)
    assert found.median_px == pytest.approx(np.median(none))
    assert found.far_off_share == pytest.approx(np.mean(none > FAR_OFF_PX))


@pytest.mark.parametrize("unit", [1e-12, 1e-3, 1e9, 1e15])
def test_errors_in_px_are_the_same_in_any_unit_of_the_estimate(unit):
    rng = np.random.default_rng(0)
    truth = rng.uniform(1, 4, (1, 40, 50)).astype(np.float32)
    estimate = (1 / (0.9 / truth + rng.normal(0, 0.005, truth.shape))).astype(np.float32)
    own, other = (depth_errors(u * estimate, truth, parallax=20.0) for u in (np.float32(1), np.float32(unit)))
    assert own.median_px > 0.03
    assert other.median_px == pytest.approx(own.median_px, rel=1e-4)


def test_without_the_path_there_are_no_errors_in_px():
    found = depth_errors(ramp(), ramp())
    assert found.median_px is found.far_off_share is None
    poses = np.tile(np.eye(4), (3, 1, 1))
    assert parallax_of(poses, np.diag([50.0, 50, 1])) is None
    assert parallax_of(poses[:1], np.diag([50.0, 50, 1])) is None
    poses[:, 0, 3] = [0, -0.2, -0.4]
    assert parallax_of(poses, np.diag([50.0, 50, 1])) == pytest.approx(10)


def test_words_say_what_is_known():
    known = depth_errors(ramp(), ramp(), parallax=20.0).in_words()
    assert known == ("0.00% off", "rank correlation 1.000, 100.0% within 1.25; 0.000 px, 0.0% over 0.25")
    plane = np.full((1, 3, 4), 2, np.float32)
    assert depth_errors(plane, plane).in_words() == ("0.00% off", "100.0% within 1.25")
