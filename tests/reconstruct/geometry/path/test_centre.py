"""A principal point that may move with the camera: told by turns in step with travel, and by nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.findings import Code
from gs2ci.reconstruct.geometry.path.centre import doubts_about_centre, turning
from gs2ci.reconstruct.geometry.path.motion import MotionSettings, Sightings, adjust, predict_positions, start_motion
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks

SIZE, FOCAL, VIEWS, REFERENCE = (96, 128), 360.0, 8, 4
DEPTHS = np.tile(np.linspace(0.6, 1.6, 128, dtype=np.float32), (96, 1))


@pytest.fixture
def intrinsics():
    return np.array([[FOCAL, 0, 64], [0, FOCAL, 48], [0, 0, 1.0]])


def path(about, wobble_px=0.0, seed=0, towards=(1.0, 0.3)):
    """Cameras along a line that turn about a point at an inverse depth, and wobble."""
    rng = np.random.default_rng(seed)
    travel = np.linspace(-0.04, 0.04, VIEWS)[:, None] * np.array([*towards, 0.0]) / np.hypot(*towards)
    travel -= travel[REFERENCE]
    turns = about * np.stack([travel[:, 1], -travel[:, 0], 0 * travel[:, 0]], axis=1)
    turns += wobble_px / FOCAL * rng.standard_normal(turns.shape) * (np.arange(VIEWS) != REFERENCE)[:, None]
    poses = np.tile(np.eye(4), (VIEWS, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = Rotation.from_rotvec(turns).as_matrix(), travel
    return poses


def said(poses, intrinsics, depths=DEPTHS):
    return [note.code for note in doubts_about_centre(poses, intrinsics, depths, REFERENCE)]


def test_a_turn_in_step_with_travel_about_a_point_inside_the_scene_is_named_with_its_shift(intrinsics):
    (note,) = doubts_about_centre(path(1.0), intrinsics, DEPTHS, REFERENCE)
    assert note.code is Code.CENTRE_MAY_MOVE
    assert note.figures["shift_px"] == pytest.approx(FOCAL * 0.08 / 7, rel=1e-3)
    assert "by about 4.1 px or more from view to view" in note.sentence


def test_what_is_left_between_both_models_is_what_their_pictures_differ_by(intrinsics):
    """In the corner of the farthest view, across the travel: the turn against a shift along it."""
    poses = path(1.0, towards=(1.0, 0.0))
    found = turning(poses, intrinsics, SIZE, REFERENCE)
    corners = np.array([[0.0, 0.0], [128.0, 0.0], [0.0, 96.0], [128.0, 96.0]])
    turned = predict_positions(corners, np.zeros(4), poses, intrinsics)
    assert np.abs(turned - corners[:, None])[..., 1].max() == pytest.approx(found.apart_px, rel=0.2)


@pytest.mark.parametrize("seed", range(12))
def test_a_centre_that_stays_is_not_taken_for_one_that_moves(intrinsics, seed):
    """A stage that wobbles, and paths that err by a turn in step with their travel, as far as their depths allow."""
    towards = np.random.default_rng([seed, 1]).standard_normal(2)
    assert said(path(0.0, wobble_px=0.3, seed=seed, towards=towards), intrinsics) == []
    assert said(path(0.5 * seed / 12, wobble_px=0.05, seed=seed, towards=towards), intrinsics) == []


@pytest.mark.parametrize("about", [-1.0, 1.9])
def test_nor_one_that_turns_away_or_about_a_point_before_the_scene(intrinsics, about):
    assert said(path(about), intrinsics) == []


def test_nor_one_of_a_hand_that_turns_about_a_point_of_the_scene_but_not_in_step(intrinsics):
    assert said(path(1.0, wobble_px=0.3), intrinsics) == []


def test_nor_one_of_a_camera_that_mostly_goes_forwards_and_drifts_aside(intrinsics):
    poses = path(1.0)
    poses[:, 2, 3] = -3 * np.linspace(-0.04, 0.04, VIEWS)
    poses[:, 2, 3] -= poses[REFERENCE, 2, 3]
    assert turning(poses, intrinsics, SIZE, REFERENCE).ahead == pytest.approx(3)
    assert said(poses, intrinsics) == []


def test_where_the_field_of_view_is_wide_views_tell_a_turn_from_a_shift(intrinsics):
    wide = replace_focal(intrinsics, 100.0)
    poses = path(1.0, towards=(1.0, 0.0))
    poses[:, :3, 3] *= 2
    poses[:, :3, :3] = Rotation.from_rotvec(2 * Rotation.from_matrix(poses[:, :3, :3]).as_rotvec()).as_matrix()
    assert turning(poses, wide, SIZE, REFERENCE).apart_px > 1
    assert said(poses, wide) == []


def test_where_little_is_known_nothing_is_said(intrinsics):
    assert doubts_about_centre(path(1.0)[:3], intrinsics, DEPTHS, 1) == ()
    assert said(path(1.0), intrinsics, np.zeros_like(DEPTHS)) == []
    still = np.tile(np.eye(4), (VIEWS, 1, 1))
    assert turning(still, intrinsics, SIZE, REFERENCE) is None
    assert turning(still[:1], intrinsics, SIZE, 0) is None
    assert said(still, intrinsics) == []


def test_tracks_of_shifted_sensors_make_a_pinhole_turn_in_step(intrinsics):
    """The bundle adjustment, which knows no shift, finds the turn from what parallel shifted cameras see.

    Of the shift, as much as the farthest points' parallax is told from it by nothing: they may be at infinity.
    """
    rng = np.random.default_rng(3)
    places, inverse = rng.uniform((4, 4), (124, 92), (150, 2)), rng.uniform(0.6, 1.6, 150)
    poses = path(0.0)
    seen = predict_positions(places, inverse, poses, intrinsics)
    shift = -FOCAL * 1.1 * poses[:, :2, 3]
    tracks = Tracks(seen + shift, REFERENCE)
    begin = replace(start_motion(Sightings.of(tracks, intrinsics)), inverse_depth=inverse)
    motion = adjust(tracks, intrinsics, MotionSettings(huber_px=0.1), start=begin)
    depths = motion.inverse_depth[None].astype(np.float32)
    found = turning(motion.world_to_camera, intrinsics, SIZE, REFERENCE)
    (note,) = doubts_about_centre(motion.world_to_camera, intrinsics, depths, REFERENCE)
    assert note.code is Code.CENTRE_MAY_MOVE
    assert found.wobble_px < 0.05
    assert note.figures["shift_px"] == pytest.approx(FOCAL * (1.1 - inverse.min()) * 0.08 / 7, rel=0.1)


def replace_focal(intrinsics, focal):
    changed = intrinsics.copy()
    changed[0, 0] = changed[1, 1] = focal
    return changed
