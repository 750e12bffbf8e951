"""A geometry inside out, and what tracks say of it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.reconstruct.geometry.depth.view_depths import ViewDepth
from gs2ci.reconstruct.geometry.initialise import Geometry, initialise
from gs2ci.reconstruct.geometry.path.motion import (
    MotionSettings,
    adjust,
    predict_positions,
    preference,
    reversed_depth,
)
from gs2ci.reconstruct.geometry.reversal import reversed_geometry, share_with_travel, turned
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks

HUBER_PX = MotionSettings().huber_px


def sideways(views=8, extent=0.05):
    poses = np.tile(np.eye(4), (views, 1, 1))
    poses[:, 0, 3] = extent * (np.arange(views) - views // 2) / views
    return poses


def geometry_of(scene, inverse_depth):
    return Geometry(scene.poses, scene.intrinsics, "file", inverse_depth, 4, 300, 0.1, 1.0, "full", ())


def corners_of(size=(24, 32), within=(240, 320)):
    rows, columns = np.indices(size).reshape(2, -1) + 0.5
    return np.column_stack([columns * within[1] / size[1], rows * within[0] / size[0]])


def seen_of(geometry, focal_px):
    intrinsics = geometry.intrinsics.copy()
    intrinsics[0, 0] = intrinsics[1, 1] = focal_px
    depth = geometry.inverse_depth.reshape(-1).astype(np.float64)
    return predict_positions(corners_of(), depth, geometry.world_to_camera, intrinsics)


@pytest.fixture
def slope(tracked):
    scene = tracked(poses=sideways())
    return geometry_of(scene, np.linspace(0.7, 1.3, 24 * 32, dtype=np.float32).reshape(24, 32))


def test_a_reversal_exchanges_near_and_far_and_reverses_the_path(slope):
    back = reversed_geometry(slope)
    assert np.corrcoef(back.inverse_depth.ravel(), slope.inverse_depth.ravel())[0, 1] == pytest.approx(-1)
    np.testing.assert_allclose(back.world_to_camera[:, :3, 3], -slope.world_to_camera[:, :3, 3])
    assert back.verdict == slope.verdict


def test_a_reversal_leaves_out_the_depths_of_further_views(slope):
    mapped = replace(slope, view_depths=(ViewDepth(slope.reference, slope.inverse_depth),))
    assert reversed_geometry(mapped).view_depths == ()


def test_reversed_twice_is_as_it_was(slope):
    again = reversed_geometry(reversed_geometry(slope))
    np.testing.assert_allclose(again.inverse_depth, slope.inverse_depth, rtol=1e-5)
    np.testing.assert_allclose(again.world_to_camera, slope.world_to_camera, atol=1e-6)


def test_from_afar_both_orders_look_alike_and_from_near_they_do_not(slope):
    """The same motion on the screen: from so far away that it stays in the first order, and from near."""

    def apart_px(focal_px):
        scale = 300 / focal_px  # the same shifts on the screen
        near = slope.world_to_camera.copy()
        near[:, :3, 3] *= scale
        one = replace(slope, world_to_camera=near)
        return np.abs(seen_of(one, focal_px) - seen_of(reversed_geometry(one), focal_px)).max()

    shift_px = np.ptp(seen_of(slope, 300.0)[:, :, 0], axis=1).max()
    assert shift_px > 10
    assert apart_px(6000.0) < 0.02
    assert apart_px(300.0) > 1.0


def test_what_lies_nearer_than_twice_the_median_stays_before_the_camera(slope):
    near = replace(slope, inverse_depth=np.where(slope.inverse_depth > 1.25, 5.0, slope.inverse_depth))
    back = reversed_geometry(near)
    assert back.inverse_depth.min() > 0
    assert np.isfinite(back.inverse_depth).all()


@pytest.fixture
def small(slope):
    """The same with a camera matrix of the depth map's own size."""
    return replace(slope, intrinsics=np.diag([0.1, 0.1, 1.0]) @ slope.intrinsics)


def turning(geometry, stays_put):
    """Turn each camera so that what lies at this inverse depth stays put on the screen, to first order."""
    poses = geometry.world_to_camera.copy()
    shifts = poses[:, :3, 3]
    about = stays_put * np.stack([shifts[:, 1], -shifts[:, 0], np.zeros(len(shifts))], axis=1)
    poses[:, :3, :3] = Rotation.from_rotvec(about).as_matrix()
    return replace(geometry, world_to_camera=poses)


def test_all_motion_goes_with_the_travel_of_a_camera_that_does_not_turn_and_none_with_its_reversal(small):
    assert share_with_travel(small) == pytest.approx(1.0)
    assert share_with_travel(reversed_geometry(small)) < 0.01


def test_where_the_middle_of_the_scene_stays_put_either_travel_explains_half(small):
    narrow = replace(small, intrinsics=np.array([[300.0, 0, 16], [0, 300, 12], [0, 0, 1]]))
    held = turning(narrow, 1.0)
    assert share_with_travel(held) == pytest.approx(0.5, abs=0.05)
    assert share_with_travel(reversed_geometry(held)) == pytest.approx(0.5, abs=0.05)


def test_a_camera_that_turns_a_little_still_moves_the_picture_with_its_travel(small):
    assert share_with_travel(turning(small, 0.3)) > 0.99


def test_a_camera_at_rest_or_that_only_turns_has_no_travel(small):
    rest = replace(small, world_to_camera=np.tile(np.eye(4), (8, 1, 1)))
    assert share_with_travel(rest) == 0.5
    poses = turning(small, 1.0).world_to_camera.copy()
    poses[:, :3, 3] = 0
    assert share_with_travel(replace(small, world_to_camera=poses)) == 0.5


def test_points_that_pass_through_a_camera_leave_the_share_a_number(small):
    poses = small.world_to_camera.copy()
    poses[:, 2, 3] = -1 / float(small.inverse_depth[0, 0])
    assert 0 <= share_with_travel(replace(small, world_to_camera=poses)) <= 1


def both_ways(scene):
    here = adjust(scene.tracks, scene.intrinsics)
    return here, adjust(scene.tracks, scene.intrinsics, start=reversed_depth(here))


def test_tracks_in_a_wide_field_of_view_prefer_the_right_order_surely(tracked):
    scene = tracked(noise_px=0.2, focal=200.0, poses=sideways(extent=0.2))
    here, there = both_ways(scene)
    right = np.corrcoef(here.inverse_depth, scene.inverse_depth)[0, 1] > 0
    errors = preference(here, there, HUBER_PX) * (1 if right else -1)
    assert errors > 6
    assert preference(there, here, HUBER_PX) == pytest.approx(-preference(here, there, HUBER_PX))


def test_tracks_in_a_narrow_field_of_view_cannot_tell(tracked):
    scene = tracked(noise_px=0.5, focal=3000.0, poses=sideways(extent=0.01))
    assert abs(preference(*both_ways(scene), HUBER_PX)) < 4


def test_one_track_prefers_nothing(tracked):
    scene = tracked()
    alone = replace(scene, tracks=Tracks(scene.tracks.positions[:1], scene.tracks.reference))
    assert preference(*both_ways(alone), HUBER_PX) == 0.0


def test_tracks_that_are_not_sure_hand_over_the_other_order(seen):
    """Two planes from afar: a narrow field of view, in which perspective shifts by hundredths of a pixel."""
    poses = sideways(5, extent=0.006)
    scene = seen(poses=poses, focal=1500.0)
    found = initialise(scene.views, scene.intrinsics)
    assert found.verdict == "full"
    assert found.order_errors is not None
    assert found.order_errors < 6
    other = turned(found)
    assert np.corrcoef(found.inverse_depth.ravel(), other.inverse_depth.ravel())[0, 1] < 0
    assert other.order_errors == -found.order_errors
    assert np.array_equal(turned(other).world_to_camera, found.world_to_camera)
