from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.reconstruct.uncertainty.depths import errors_of_depths, movement
from gs2ci.reconstruct.uncertainty.factors import factors
from gs2ci.reconstruct.uncertainty.information import information
from tests.reconstruct.uncertainty.conftest import path


def stated(seen, spread=0.0, path_error=0.0, *, given=False, reference=3):
    known = information(seen, reference, (1e-4, 1e-5) if given else None)
    return errors_of_depths(known, seen, np.full_like(seen.depth, spread), path_error, given=given)


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
    relative = stated(replace(seen, depth=far), given=True) / far
    assert relative[:, :, 24].mean() > 4 * relative[:, :, 8].mean()


def test_thick_light_and_jumps_of_depth_are_less_sure(seen):
    thin, thick = stated(seen, 0.0, given=True), stated(seen, 0.1, given=True)
    assert (thick > thin).all()
    assert thick[3, 5, 5] ** 2 - thin[3, 5, 5] ** 2 == pytest.approx((factors.depth_by_spread * 0.1 * 2) ** 2, rel=1e-3)
    assert thin[3, 12, 16] > 1.5 * thin[3, 12, 28]


def test_a_doubtful_path_makes_depths_off_the_middle_one_less_sure(seen):
    sure, doubtful = (stated(seen, path_error=error) / seen.depth for error in (0.0, 0.2))
    grown = np.sqrt(np.maximum(doubtful**2 - sure**2, 0))
    assert (grown > 0.1).all()


def test_given_poses_make_depths_surer(seen):
    assert stated(seen, given=True).mean() < stated(seen).mean()


@pytest.mark.parametrize("count", [1, 6])
def test_a_camera_at_rest_tells_no_depth(seen, count):
    still = replace(
        seen,
        views=seen.views[:count],
        depth=seen.depth[:count],
        world_to_camera=path(count, (0, 0, 0)),
        transmissions=seen.transmissions[:count],
    )
    assert np.allclose(stated(still, reference=0), still.depth)


def test_without_any_depth_there_is_no_error(seen):
    assert not stated(replace(seen, depth=np.zeros_like(seen.depth))).any()


def test_a_point_moves_by_the_parallax_of_its_depth():
    poses = path(5)
    near, far = (torch.tensor([0, 0, depth], dtype=torch.float64).unbind() for depth in (2.0, 1e6))
    found = movement(poses, np.array([35.0, 35.0]), 2, near)
    places = 35 * np.linspace(-0.1, 0.1, 5) / 2
    assert float(found) == pytest.approx(np.sqrt(np.square(places).sum()))
    assert float(movement(poses, np.array([35.0, 35.0]), 2, far)) == factors.place_px
