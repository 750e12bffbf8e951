"""The kernel that carries places against the same in numpy."""

import numpy as np
import pytest

from gs2ci.core.cameras import pinhole
from gs2ci.reconstruct.geometry.depth.carrying import carried_places

SIZE = (40, 60)
INTRINSICS = pinhole(50.0, SIZE)


def in_numpy(places, inverse_depth, pose, intrinsics):
    """Iterate depth and place as the kernel does, each line for all places at once."""
    height, width = inverse_depth.shape

    def rays(at):
        return np.column_stack([at, np.ones(len(at))]) @ np.linalg.inv(intrinsics).T

    at = places
    for _ in range(4):
        columns, rows = (at[:, i].clip(0, side - 1).astype(int) for i, side in enumerate((width, height)))
        depth = 1 / inverse_depth[rows, columns].astype(np.float64)
        along = rays(at) * depth[:, None] @ pose[2, :3] + pose[2, 3]
        seen = rays(places) * np.maximum(along, 1e-3 * depth)[:, None] - pose[:3, 3]
        points = seen @ pose[:3, :3] @ intrinsics.T
        ahead = points[:, 2] > 0
        there = points[:, :2] / np.where(ahead, points[:, 2], 1.0)[:, None]
        at = np.where(ahead[:, None], there.clip(-1e4, 1e4), at)
    return at - 0.5


def carried(places, inverse_depth, pose):
    return carried_places(places, inverse_depth, pose, INTRINSICS, np.linalg.inv(INTRINSICS))


@pytest.fixture
def places():
    return np.random.default_rng(0).uniform((-5, -5), (SIZE[1] + 5, SIZE[0] + 5), (500, 2))


@pytest.mark.parametrize("length", [0.0, 0.05, 0.5, 30.0])
def test_it_is_what_numpy_says_along_a_hand_held_path(places, path, length):
    draws = np.random.default_rng(1)
    inverse_depth = draws.uniform(0.3, 2.0, SIZE).astype(np.float32)
    for pose in path(5, draws, length=length, turn=0.05):
        found = carried(places, inverse_depth, pose)
        np.testing.assert_allclose(found, in_numpy(places, inverse_depth, pose, INTRINSICS), rtol=1e-6, atol=1e-4)


def test_what_lies_behind_the_middle_view_stays_where_it_is(places):
    pose = np.eye(4)
    pose[2, 3] = 1e3
    turned = np.diag([-1.0, 1, -1, 1])
    assert np.isfinite(carried(places, np.ones(SIZE, np.float32), pose)).all()
    np.testing.assert_array_equal(carried(places, np.ones(SIZE, np.float32), turned), np.float32(places - 0.5))


def test_a_place_or_a_depth_that_is_no_number_reads_nothing_outside_the_map(places):
    pose = np.eye(4)
    pose[0, 3] = 0.1
    places[0] = np.nan
    depth = np.full(SIZE, np.nan, np.float32)
    np.testing.assert_array_equal(carried(places, depth, pose)[1:], np.float32(places[1:] - 0.5))
    assert np.isnan(carried(places, np.ones(SIZE, np.float32), pose)[0]).all()
    # A plane at infinity does not shift.
    far = carried(places[1:], np.full(SIZE, 1e-30, np.float32), pose)
    np.testing.assert_allclose(far, places[1:] - 0.5, atol=1e-4)
