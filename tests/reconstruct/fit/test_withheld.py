from dataclasses import replace

import numpy as np
import pytest

from gs2ci.reconstruct.fit.withheld import Withheld
from gs2ci.reconstruct.geometry.depth.view_depths import ViewDepth
from gs2ci.reconstruct.geometry.points import seed_points

NOTHING, POINTS, POSES = Withheld(), Withheld(points=True), Withheld(poses=True)


@pytest.fixture
def geometry(moving_plane):
    return moving_plane[1]


@pytest.fixture
def views(moving_plane):
    shot, _ = moving_plane
    return np.random.default_rng(0).random((*shot.masks.shape, 3)).astype(np.float32)


def test_nothing_withheld_leaves_the_geometry_and_its_points(geometry, views):
    assert NOTHING.first_poses(geometry) is geometry
    given, plain = NOTHING.first_points(geometry, views, 3, seed=1), seed_points(geometry, views, 3)
    for name in ("positions", "colours", "spacing"):
        np.testing.assert_array_equal(getattr(given, name), getattr(plain, name))


def test_withheld_poses_are_all_that_of_the_reference_view(geometry):
    own = geometry.world_to_camera[geometry.reference]
    mapped = replace(geometry, view_depths=(ViewDepth(geometry.reference, geometry.inverse_depth),))
    assert POSES.first_poses(mapped).view_depths == ()
    np.testing.assert_array_equal(POSES.first_poses(geometry).world_to_camera, np.repeat(own[None], 4, axis=0))
    assert POINTS.first_poses(geometry) is geometry


def test_withheld_points_are_as_many_and_seen_by_the_reference_view_but_tell_nothing(geometry, views):
    points, known = POINTS.first_points(geometry, views, 2, seed=1), seed_points(geometry, views, 2)
    for name in ("positions", "colours", "spacing"):
        assert getattr(points, name).shape == getattr(known, name).shape
        assert getattr(points, name).dtype == np.float32
    depth = points.positions[:, 2]
    pixels = (points.positions @ geometry.intrinsics.T)[:, :2] / depth[:, None]
    height, width = geometry.inverse_depth.shape
    assert ((pixels >= -1e-3) & (pixels <= np.array([width, height]) + 1e-3)).all()
    assert depth.min() >= 0.5 * (1 - 1e-6)
    assert depth.max() <= 2 * (1 + 1e-6)
    assert np.ptp(depth) > 1
    assert (points.spacing > 0).all()
    assert abs(np.corrcoef(points.colours[:, 0], known.colours[:, 0])[0, 1]) < 0.2


def test_the_seed_decides_the_random_points(geometry, views):
    first, again, other = (POINTS.first_points(geometry, views, 3, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.positions, again.positions)
    assert (first.positions != other.positions).any()
