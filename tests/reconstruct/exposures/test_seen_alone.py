"""What an exposure alone shows, and would be lost without it."""

import numpy as np
import pytest

from gs2ci.core.cameras import pinhole
from gs2ci.core.lens import distorted, slopes_of
from gs2ci.reconstruct.exposures.merging import ViewsTogether, seen_alone

SIZE = (48, 64)
FOCAL_PX = 60.0
VIEWS = 4


def before_a_wall(starts, *, travel=0.1, z=2.0, distortion=None):
    """Look straight at a wall from paths that begin at so many places."""
    poses = np.tile(np.eye(4), (VIEWS * len(starts), 1, 1))
    poses[:, 0, 3] = -np.concatenate([start + travel * np.arange(VIEWS) for start in starts])
    depth = np.full((len(poses), *SIZE), z, np.float32)
    own = np.repeat(np.arange(len(starts)), VIEWS)
    return ViewsTogether(depth, poses, pinhole(FOCAL_PX, SIZE), distortion, own)


@pytest.mark.parametrize("count", [2, 4])
def test_repeats_show_nothing_alone(count):
    assert seen_alone(before_a_wall([0.0] * count)) == (0.0,) * count


def test_ground_that_no_other_exposure_sees_would_be_lost():
    seen = 2.0 * SIZE[1] / FOCAL_PX
    assert seen_alone(before_a_wall([0.0, seen / 2], travel=0.0)) == pytest.approx((0.5, 0.5), abs=0.05)
    assert seen_alone(before_a_wall([0.0, 3 * seen])) == (1.0, 1.0)
    assert seen_alone(before_a_wall([0.0])) == (1.0,)


def test_what_hides_a_point_is_no_sight_of_it():
    views = before_a_wall([0.0, 0.2])
    views.depth[VIEWS:] = 1.0
    assert seen_alone(views) == (1.0, 1.0)


def test_pixels_without_depth_have_no_part():
    views = before_a_wall([0.0, 0.0])
    views.depth[VIEWS:] = 0
    assert seen_alone(views) == (1.0, 0.0)


def test_a_lens_bends_where_points_are_seen():
    straight = before_a_wall([0.0, 0.4])
    bent = before_a_wall([0.0, 0.4], distortion=np.array([-0.15, 0.0, 0.0, 0.0, 0.0]))
    point = np.array([[0.9, 0.7, 2.0]])
    there = distorted(slopes_of(np.array([[59.0, 45.0]]), bent.intrinsics), bent.distortion)
    assert np.abs(there).max() < 0.5
    assert [views.sees(0, 1.22 * point)[0] for views in (straight, bent)] == [False, False]
    edge = np.array([[1.08, 0.0, 2.0]])
    assert [views.sees(0, edge)[0] for views in (straight, bent)] == [False, True]
    assert 0 < seen_alone(bent)[0] < 1


def test_what_a_lens_would_fold_back_into_the_picture_is_not_seen():
    lens = np.array([-0.15, 0.0, 0.0, 0.0, 0.0])
    # At a slope of 2.4 this polynomial gives 0.33, well inside the picture, whose border lies at 0.55.
    far = np.array([2.4, 0.0])
    assert distorted(far, lens)[0] == pytest.approx(0.326, abs=1e-3)
    views = before_a_wall([0.0, 4.8], travel=0.0, distortion=lens)
    assert not views.sees(0, np.array([[4.8, 0.0, 2.0]]))[0]
    assert seen_alone(views) == (1.0, 1.0)
