import dataclasses

import numpy as np

from gs2ci_sims.motion import image_motion_px, image_travel_px
from gs2ci_sims.path import StageMove

INTERVALS = np.array([[-0.1, 0.0], [0.0, 0.3]])


def test_a_sideways_move_shifts_the_nearest_points_by_focal_times_move_over_depth(small_scene):
    motion = image_motion_px(small_scene, StageMove((0.2, 0.0, 0.0)), INTERVALS)
    near, _ = small_scene.depth_range()
    np.testing.assert_allclose(motion, small_scene.intrinsics[0, 0] * 0.2 * np.array([0.1, 0.3]) / near, rtol=1e-9)


def test_the_reference_pose_makes_no_difference_to_what_moves_in_the_image(small_scene):
    turned = np.array([[0, 0, -1, 0.3], [0, 1, 0, 0], [1, 0, 0, 2.0], [0, 0, 0, 1.0]])
    elsewhere = dataclasses.replace(small_scene, world_to_camera=turned)
    here = image_motion_px(small_scene, StageMove((0.2, 0.1, 0.1), 0.1, 2.0), INTERVALS)
    there = image_motion_px(elsewhere, StageMove((0.2, 0.1, 0.1), 0.1, 2.0, turned), INTERVALS)
    np.testing.assert_allclose(there, here, rtol=1e-9)


def test_a_camera_that_drives_through_the_scene_gets_a_finite_answer(small_scene):
    motion = image_motion_px(small_scene, StageMove((0.0, 0.0, 100.0)), INTERVALS)
    assert np.isfinite(motion).all()


def test_a_camera_that_swings_back_within_an_interval_has_moved_all_the_same(small_scene):
    swing = StageMove((0.0, 0.0, 0.0), wobble_deg=0.5, wobble_hz=10.0)
    assert image_motion_px(small_scene, swing, np.array([[0.0, 0.1]])).min() > 1.0


def test_travel_adds_up_what_the_intervals_hold(small_scene):
    move = StageMove((0.2, 0.0, 0.0))
    travel = image_travel_px(small_scene, move, np.array([0.0, 0.1, 0.3]))
    inside = image_motion_px(small_scene, move, np.array([[0.0, 0.1], [0.1, 0.3]]))
    np.testing.assert_allclose(np.diff(travel), inside, rtol=1e-9)
