from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import GeometryError, InputError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.geometry.path.motion import predict_positions
from gs2ci.reconstruct.geometry.path.telemetry import (
    errors_of_given,
    movement,
    place_points,
    poses_of_stage,
    stated_error,
)
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks

INTRINSICS = np.array([[300.0, 0, 160], [0, 310.0, 120], [0, 0, 1]])
REFERENCE = 3


def stage_poses(views=7, step_mm=4.0, turn_deg=0.3):
    """A stage move along x in millimetres, seen in some frame of the bench, with a slight turn."""
    poses = np.tile(np.eye(4), (views, 1, 1))
    for i in range(views):
        poses[i, :3, :3] = Rotation.from_euler("y", turn_deg * i, degrees=True).as_matrix()
        poses[i, :3, 3] = (step_mm * i, 0.1 * i, 20.0)
    return poses


def tracks_of(poses, depth_mm, noise_px, rng):
    relative = poses @ np.linalg.inv(poses[REFERENCE])
    at = rng.uniform((5, 5), (315, 235), (len(depth_mm), 2))
    positions = predict_positions(at, 1 / depth_mm, relative, INTRINSICS)
    positions += noise_px * rng.standard_normal(positions.shape)
    return Tracks(positions, REFERENCE)


def test_depths_follow_from_known_poses_at_the_scale_of_median_one():
    rng = np.random.default_rng(0)
    depth_mm = rng.uniform(400, 1500, 300)
    tracks = tracks_of(stage_poses(), depth_mm, 0.0, rng)
    motion, kept = place_points(tracks, stage_poses(), INTRINSICS, 1.0, 3.0)
    assert len(kept) == 300
    expected = np.median(1 / depth_mm)
    np.testing.assert_allclose(motion.inverse_depth * expected, 1 / depth_mm, rtol=1e-6)
    relative = stage_poses() @ np.linalg.inv(stage_poses()[REFERENCE])
    np.testing.assert_allclose(motion.translations, relative[:, :3, 3] * expected, rtol=1e-6, atol=1e-12)
    assert motion.rms_px < 1e-9


def test_noise_and_outliers_leave_the_depths_within_their_error():
    rng = np.random.default_rng(1)
    depth_mm = rng.uniform(400, 900, 200)
    tracks = tracks_of(stage_poses(), depth_mm, 0.3, rng)
    tracks.positions[:20, 5] += 25.0
    motion, kept = place_points(tracks, stage_poses(), INTRINSICS, 1.0, 3.0)
    assert 150 < len(kept) <= 180
    depth = 1 / (motion.inverse_depth * np.median(1 / depth_mm))
    honest = np.isin(tracks.positions[:, 0, 0], kept.positions[:, 0, 0])
    # 12 mm to either side at 650 mm move a point by 5.5 px; 0.3 px in the reference view alone are 5 % of that.
    assert np.median(np.abs(depth / depth_mm[honest] - 1)) < 0.03


def test_points_that_few_views_see_are_placed_by_those():
    rng = np.random.default_rng(2)
    depth_mm = rng.uniform(400, 900, 50)
    tracks = tracks_of(stage_poses(), depth_mm, 0.0, rng)
    tracks.positions[:25, :2] = np.nan
    motion, kept = place_points(tracks, stage_poses(), INTRINSICS, 1.0, 3.0)
    assert len(kept) == 50
    np.testing.assert_allclose(motion.inverse_depth * np.median(1 / depth_mm), 1 / depth_mm, rtol=1e-6)


@pytest.mark.parametrize("change", ["still", "reversed"])
def test_poses_that_contradict_the_tracks_are_refused(change):
    rng = np.random.default_rng(3)
    poses = stage_poses(turn_deg=0.0)
    tracks = tracks_of(poses, rng.uniform(400, 900, 50), 0.1, rng)
    wrong = poses.copy()
    if change == "still":
        wrong[:] = wrong[0]
    else:
        wrong[:, 0, 3] *= -1
    with pytest.raises(GeometryError, match="infinity or behind"):
        place_points(tracks, wrong, INTRINSICS, 1.0, 3.0)


def test_a_change_of_frame_is_no_movement_and_a_shift_is_a_share_of_the_path():
    poses = stage_poses(turn_deg=0.0)
    frame = np.eye(4)
    frame[:3, :3] = Rotation.from_euler("xyz", (10, 20, 30), degrees=True).as_matrix()
    frame[:3, 3] = (1, 2, 3)
    still = movement(poses, poses @ frame)
    assert still.rotation_deg < 1e-6
    assert still.share_of_path < 1e-9
    shifted = poses.copy()
    shifted[0, 0, 3] += 2.4
    assert movement(poses, shifted).share_of_path == pytest.approx(2.4 / np.sqrt(7) / np.hypot(24, 0.6))
    turned = poses.copy()
    turned[6, :3, :3] = Rotation.from_euler("y", 1.0, degrees=True).as_matrix() @ turned[6, :3, :3]
    assert movement(poses, turned).rotation_deg == pytest.approx(1 / np.sqrt(7))


def test_what_a_shot_states_of_its_stage_is_an_error_of_places():
    shot = Shot(np.ones((4, 4, 1), np.float32), np.ones((2, 4, 4), np.float32), np.ones(2, np.float32))
    assert stated_error(shot, "position_error") is None
    assert stated_error(replace(shot, provenance={"telemetry": {"axes_from": "x"}}), "position_error") is None
    assert stated_error(replace(shot, provenance={"telemetry": {"position_error": 0.02}}), "position_error") == 0.02


@pytest.mark.parametrize("error", [0, -1.0, float("nan"), float("inf"), "0.1", True])
def test_an_error_of_places_that_is_none_is_refused(error):
    shot = Shot(np.ones((4, 4, 1), np.float32), np.ones((2, 4, 4), np.float32), np.ones(2, np.float32))
    with pytest.raises(InputError, match="position_error"):
        stated_error(replace(shot, provenance={"telemetry": {"position_error": error}}), "position_error")


def test_unstated_errors_are_a_share_of_the_path_and_turns_a_part_of_a_pixel():
    poses = stage_poses(turn_deg=0.0)
    assert errors_of_given(poses, INTRINSICS).position == pytest.approx(0.01 * np.hypot(24, 0.6))
    assert errors_of_given(poses, INTRINSICS, 0.3).position == 0.3
    assert errors_of_given(poses, INTRINSICS).rotation == pytest.approx(0.1 / 300)
    stated = errors_of_given(poses, INTRINSICS, turn_error_deg=3.0)
    in_step = np.std(np.radians(np.linspace(-1.5, 1.5, 1001)))
    assert stated.rotation == pytest.approx(np.hypot(0.1 / 300, in_step), rel=1e-2)
    assert errors_of_given(np.tile(np.eye(4), (3, 1, 1)), INTRINSICS).position > 0


def test_a_camera_at_rest_has_no_path_to_share():
    poses = np.tile(np.eye(4), (3, 1, 1))
    assert movement(poses, poses).share_of_path == 0.0


def test_a_shot_without_telemetry_has_no_poses_of_a_stage():
    shot = Shot(np.ones((4, 4, 1), np.float32), np.ones((2, 4, 4), np.float32), np.ones(2, np.float32))
    with pytest.raises(InputError, match="no poses from a stage"):
        poses_of_stage(shot)
    poses = np.tile(np.eye(4), (2, 1, 1))
    assert poses_of_stage(replace(shot, telemetry_world_to_camera=poses)) is poses
