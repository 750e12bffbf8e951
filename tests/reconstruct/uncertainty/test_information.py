"""What readings tell, against the same derivatives by moving things, and where nothing can be told."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.reconstruct.uncertainty import information as module
from gs2ci.reconstruct.uncertainty.information import flows_between, information


def test_the_flow_of_points_is_that_of_their_projections():
    rng = np.random.default_rng(0)
    points, focal = rng.uniform((-1, -1, 2), (1, 1, 4), (5, 3)), np.array([30.0, 40.0])
    found = module._flow(points, focal)
    step = 1e-6
    for axis in range(6):
        twist = np.zeros(6)
        twist[axis] = step
        moved = Rotation.from_rotvec(twist[3:]).apply(points) + twist[:3]
        by_moving = (moved[:, :2] / moved[:, 2:] - points[:, :2] / points[:, 2:]) * focal / step
        assert np.allclose(found[:, :, axis], by_moving, atol=1e-3)


def test_the_picture_of_a_wall_moves_by_the_parallax(seen):
    flow = np.sqrt(flows_between(replace(seen, depth=np.full_like(seen.depth, 2.0))))
    assert flow.shape[:2] == (6, 6)
    assert np.allclose(flow[0, 5], 35 * 0.2 / 2, rtol=1e-5)
    assert not flow[2, 2].any()


def test_less_noise_tells_more_of_poses(seen):
    loud, quiet = (information(replace(seen, noise=seen.noise * times), 3) for times in (100, 1))
    assert np.diag(quiet).sum() < np.diag(loud).sum()


def test_the_covariance_is_symmetric_and_positive(seen):
    found = information(seen, 3)
    assert np.allclose(found, found.T, atol=1e-12)
    assert np.linalg.eigvalsh(found).min() > 0


def test_the_reference_camera_is_held(seen):
    errors = np.sqrt(np.diag(information(seen, 3))).reshape(6, 6)
    assert errors[3].max() < 0.1 * errors[[0, 5]].max()


def test_given_errors_bound_those_of_the_poses(seen):
    errors = np.sqrt(np.diag(information(replace(seen, noise=seen.noise * 1e6), 3, (0.01, 0.001)))).reshape(6, 6)
    assert errors[:, :3].max() <= 0.01 + 1e-9
    assert errors[:, 3:].max() <= 0.001 + 1e-9
    assert errors[0].max() > 0.009


def test_untextured_views_tell_nothing_but_what_was_known(seen):
    blank = replace(seen, views=np.full_like(seen.views, 0.5))
    errors = np.sqrt(np.diag(information(blank, 3))).reshape(6, 6)
    assert np.allclose(errors[0, :3], 0.2)
    assert np.allclose(errors[0, 3:], 0.1)


def cells_of(seen):
    """The cells of all pixels, [N, H, W], and their number."""
    cells, number = module._cells(seen, 3, np.arange(seen.depth[0].size))
    return cells.reshape(seen.depth.shape), number


def test_every_pixel_with_a_depth_belongs_to_a_cell(seen):
    depth = seen.depth.copy()
    depth[:, :4] = 0
    cells, number = cells_of(replace(seen, depth=depth))
    assert np.array_equal(cells >= 0, depth > 0)
    assert np.array_equal(np.unique(cells), np.arange(-1, number))


def test_the_same_surface_is_one_cell_in_all_views(seen):
    wall = replace(seen, depth=np.full_like(seen.depth, 2.0))
    cells, number = cells_of(wall)
    assert np.array_equal(np.unique(cells), np.arange(number))
    # The picture moves by 0.7 px from view to view: that is 3.5 px from the first to the last.
    assert np.mean(cells[0, :, 4:] == cells[3, :, 2:-2]) > 0.6


@pytest.mark.parametrize("how", ["still", "no depth", "one view", "grey"])
def test_where_little_can_be_told_the_result_is_finite(seen, still, how):
    given = {
        "still": still,
        "no depth": replace(seen, depth=np.zeros_like(seen.depth)),
        "one view": replace(
            seen,
            views=seen.views[:1],
            depth=seen.depth[:1],
            world_to_camera=seen.world_to_camera[:1],
            transmissions=seen.transmissions[:1],
        ),
        "grey": replace(seen, views=seen.views[..., :1], noise=seen.noise[..., :1]),
    }[how]
    found = information(given, 0)
    assert found.shape == (6 * len(given.depth),) * 2
    assert np.isfinite(found).all()


def test_gradients_are_differences_per_pixel_and_none_along_a_side_of_one():
    rows, columns = np.mgrid[:9, :9].astype(np.float32)
    inside = module._gradients((3 * rows + 2 * columns)[..., None]).reshape(9, 9, 2)[4, 4]
    assert np.allclose(inside, (2, 3))
    assert np.allclose(module._gradients(columns[:1, :, None])[4, 0], (1, 0))
