from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.reconstruct.uncertainty.depths import errors_of_depths, movement
from gs2ci.reconstruct.uncertainty.factors import factors
from tests.reconstruct.uncertainty.conftest import path


def stated(seen, spread=0.0, path_error=0.0, turn=0.0, others=None):
    return errors_of_depths(seen, np.full_like(seen.depth, spread), path_error, turn, others)


def test_there_is_an_error_where_there_is_a_depth_and_none_larger_than_it(seen):
    depth = seen.depth.copy()
    depth[:, :3] = 0
    found = stated(replace(seen, depth=depth), path_error=5.0)
    assert found.dtype == np.float32
    assert np.array_equal(found > 0, depth > 0)
    assert (found <= depth).all()


def test_far_things_that_move_little_through_the_views_are_less_sure(seen):
    far = seen.depth.copy()
    far[..., 16:] = 30.0
    relative = stated(replace(seen, depth=far)) / far
    assert relative[:, :, 24].mean() > 4 * relative[:, :, 8].mean()


def test_thick_light_and_jumps_of_depth_are_less_sure(seen):
    thin, thick = stated(seen, 0.0), stated(seen, 0.1)
    assert (thick > thin).all()
    assert thick[3, 5, 5] ** 2 - thin[3, 5, 5] ** 2 == pytest.approx((factors.depth_by_spread * 0.1 * 2) ** 2, rel=1e-3)
    assert thin[3, 12, 16] > 1.5 * thin[3, 12, 28]


def test_a_doubtful_path_makes_depths_off_the_middle_one_less_sure(seen):
    sure, doubtful = (stated(seen, path_error=error) / seen.depth for error in (0.0, 0.2))
    grown = np.sqrt(np.maximum(doubtful**2 - sure**2, 0))
    assert (grown > 0.1).all()


def test_cameras_of_other_exposures_make_surer_what_they_see_and_nothing_else(seen):
    beside, away = path(1), path(1)
    beside[0, 0, 3], away[0, 0, 3] = -0.8, -50.0
    alone, seen_by_another, seen_by_none = (stated(seen, others=others) for others in (None, beside, away))
    # At depth 2 the picture of the camera beside lies 14 px to the right.
    assert (seen_by_another[3, 2:10, 18:30] < 0.5 * alone[3, 2:10, 18:30]).all()
    assert np.allclose(seen_by_another[3, 2:-2, 6:9], alone[3, 2:-2, 6:9], rtol=0.01)
    assert np.allclose(seen_by_none[3, 2:-2, 6:-6], alone[3, 2:-2, 6:-6], rtol=0.01)


def test_a_turn_in_step_with_the_travel_shifts_all_inverse_depths(seen):
    """A turn by 0.1 px in the mean over a path whose mean travel moves depth 2 by t px shifts by 0.1 / t of 1 / 2."""
    far = replace(seen, depth=np.where(seen.depth > 2, 8, seen.depth).astype(np.float32))
    far.depth[0] = 2  # so that this is the middle depth
    grown = [stated(far, turn=turn)[3, 12, 26] / 8 for turn in (0.0, 0.1 / 35)]
    travel_px = 35 * 0.2 / 2 * np.std(np.linspace(-0.5, 0.5, 6))
    share = 0.1 / (travel_px * 2 / 8)
    expected = share * np.hypot(2 / 8 - 1, share * factors.unknown_depth)
    assert np.sqrt(grown[1] ** 2 - grown[0] ** 2) == pytest.approx(expected, rel=0.02)


def test_a_turn_makes_depths_before_a_camera_that_drives_into_a_scene_unsure_near_its_way(seen):
    poses = path(6, (0, 0, 0.4))
    relative = stated(replace(seen, world_to_camera=poses), turn=0.002) / seen.depth
    assert relative[3, 12, 18] > 1.5 * relative[3, 2, 30]


@pytest.mark.parametrize("count", [1, 6])
def test_a_camera_at_rest_tells_no_depth(seen, count):
    still = replace(
        seen,
        views=seen.views[:count],
        depth=seen.depth[:count],
        world_to_camera=path(count, (0, 0, 0)),
        transmissions=seen.transmissions[:count],
    )
    assert np.allclose(stated(still), still.depth)


def test_without_any_depth_there_is_no_error(seen):
    assert not stated(replace(seen, depth=np.zeros_like(seen.depth))).any()


def test_a_point_moves_by_the_parallax_of_its_depth():
    poses = path(5)
    near, far = (torch.tensor([0, 0, depth], dtype=torch.float64).unbind() for depth in (2.0, 1e6))
    found = movement(poses, np.array([35.0, 35.0]), 2, near)
    places = 35 * np.linspace(-0.1, 0.1, 5) / 2
    assert float(found) == pytest.approx(np.sqrt(np.square(places).sum()))
    assert float(movement(poses, np.array([35.0, 35.0]), 2, far)) == factors.place_px
