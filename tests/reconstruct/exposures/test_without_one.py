"""What leaving an exposure out would change: lost ground, and standard errors of what others see as well."""

import math

import numpy as np
import pytest

from gs2ci.core.cameras import pinhole
from gs2ci.core.lens import distorted, slopes_of
from gs2ci.reconstruct.exposures.without_one import ViewsTogether, without_each

SIZE = (48, 64)
FOCAL_PX = 60.0
VIEWS = 4


def before_a_wall(starts, *, travel=0.1, z=2.0, information=1.0, distortion=None):
    """Look straight at a wall from paths that begin at so many places."""
    poses = np.tile(np.eye(4), (VIEWS * len(starts), 1, 1))
    poses[:, 0, 3] = -np.concatenate([start + travel * np.arange(VIEWS) for start in starts])
    return ViewsTogether(
        np.full((len(poses), *SIZE), z, np.float32),
        poses,
        pinhole(FOCAL_PX, SIZE),
        distortion,
        np.full(len(poses), information),
        np.repeat(np.arange(len(starts)), VIEWS),
    )


@pytest.mark.parametrize("count", [2, 4, 8])
def test_repeats_are_worth_the_root_of_their_number(count):
    for one in without_each(before_a_wall([0.0] * count, information=7.0)):
        assert one.alone == 0
        assert one.colour_times == pytest.approx(math.sqrt(count / (count - 1)))
        assert one.depth_times == pytest.approx(math.sqrt(count / (count - 1)))


def test_a_path_aside_is_worth_more_depth_than_colour():
    near, far = without_each(before_a_wall([0.0, 1.0]))
    assert near.depth_times == pytest.approx(far.depth_times, rel=0.05)
    assert near.depth_times > 4
    assert 1.3 < near.colour_times < 1.5


def test_ground_that_no_other_exposure_sees_would_be_lost():
    seen = 2.0 * SIZE[1] / FOCAL_PX
    one, other = without_each(before_a_wall([0.0, seen / 2], travel=0.0))
    assert one.alone == pytest.approx(0.5, abs=0.05)
    assert other.alone == pytest.approx(0.5, abs=0.05)
    apart = without_each(before_a_wall([0.0, 3 * seen]))
    assert [(each.alone, each.depth_times, each.colour_times) for each in apart] == [(1.0, None, None)] * 2


def test_depth_that_the_others_do_not_tell_has_no_figure():
    still = before_a_wall([0.0, 0.0], travel=0.0)
    for one in without_each(still):
        assert one.depth_times is None
        assert one.colour_times == pytest.approx(math.sqrt(2))


def test_what_hides_a_point_is_no_sight_of_it():
    views = before_a_wall([0.0, 0.2])
    views.depth[VIEWS:] = 1.0
    assert [one.alone for one in without_each(views)] == [1.0, 1.0]


def test_pixels_without_depth_have_no_part():
    views = before_a_wall([0.0, 0.0])
    views.depth[VIEWS:] = 0
    blind = without_each(views)[1]
    assert (blind.alone, blind.depth_times) == (0.0, None)


def test_a_lens_bends_where_points_are_seen():
    straight = before_a_wall([0.0, 0.4])
    bent = before_a_wall([0.0, 0.4], distortion=np.array([-0.15, 0.0, 0.0, 0.0, 0.0]))
    point = np.array([[0.9, 0.7, 2.0]])
    there = distorted(slopes_of(np.array([[59.0, 45.0]]), bent.intrinsics), bent.distortion)
    assert np.abs(there).max() < 0.5
    assert [views.sees(0, 1.22 * point)[0] for views in (straight, bent)] == [False, False]
    edge = np.array([[1.08, 0.0, 2.0]])
    assert [views.sees(0, edge)[0] for views in (straight, bent)] == [False, True]
    assert without_each(bent)[0].depth_times > 1
