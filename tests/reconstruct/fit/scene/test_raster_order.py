"""The order of Gaussians in memory."""

import torch

from gs2ci.reconstruct.fit.scene.start import raster_order

INTRINSICS = torch.tensor([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]])


def at(places: list[tuple[float, float]], depths: list[float]) -> torch.Tensor:
    """Return points that a camera at the origin sees at these pixels, [G, 3]."""
    pixels = torch.tensor([[x, y, 1.0] for x, y in places])
    return pixels @ torch.linalg.inv(INTRINSICS).T * torch.tensor(depths)[:, None]


def test_points_are_ordered_strip_by_strip_and_from_left_to_right_at_any_depth():
    means = at([(50.5, 9.5), (10.5, 1.5), (3.5, 15.5), (20.5, 7.5), (20.5, 20.5), (60.5, 0.5)], [1, 3, 2, 0.5, 1, 9])
    assert raster_order(means, torch.eye(4), INTRINSICS).tolist() == [1, 3, 5, 2, 0, 4]


def test_the_camera_that_looks_is_the_one_that_is_told():
    means = at([(10.5, 4.5), (30.5, 4.5)], [1.0, 0.5])
    # By so much to the left that the nearer point changes sides.
    beside = torch.eye(4)
    beside[0, 3] = -0.8
    assert raster_order(means, torch.eye(4), INTRINSICS).tolist() == [0, 1]
    assert raster_order(means, beside, INTRINSICS).tolist() == [1, 0]


def test_points_in_one_place_keep_their_order_and_those_behind_the_camera_have_one():
    means = torch.tensor([[0.0, 0.0, 1.0]] * 3 + [[0.0, 0.0, -1.0], [0.1, 0.0, 0.0]])
    order = raster_order(means, torch.eye(4), INTRINSICS)
    assert sorted(order.tolist()) == [0, 1, 2, 3, 4]
    assert [i for i in order.tolist() if i < 3] == [0, 1, 2]
    assert raster_order(torch.zeros(0, 3), torch.eye(4), INTRINSICS).shape == (0,)
