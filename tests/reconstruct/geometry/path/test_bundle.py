"""Bundle adjustment from given poses, against the poses and focal lengths that the tracks were made with."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import GeometryError
from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct.geometry.path import bundle
from gs2ci.reconstruct.geometry.path.bundle import adjust_bundle
from gs2ci.reconstruct.geometry.path.motion import estimate_motion, predict_positions
from gs2ci.reconstruct.geometry.path.telemetry import place_points
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks


def disturbed(poses, turn=0.004, shift=0.004, seed=3):
    rng = np.random.default_rng(seed)
    noise = np.tile(np.eye(4), (len(poses), 1, 1))
    noise[:, :3, :3] = Rotation.from_rotvec(turn * rng.normal(size=(len(poses), 3))).as_matrix()
    noise[:, :3, 3] = shift * rng.normal(size=(len(poses), 3))
    return noise @ poses


def errors(found, truth):
    """Rotation error in degrees, and path error relative to its length, at the best scale."""
    turn = np.degrees(Rotation.from_matrix(found[:, :3, :3] @ truth[:, :3, :3].transpose(0, 2, 1)).magnitude()).max()
    a, b = found[:, :3, 3], truth[:, :3, 3]
    scale = (a * b).sum() / (a * a).sum()
    return turn, np.abs(scale * a - b).max() / np.ptp(b, axis=0).max()


def test_disturbed_poses_are_put_right(tracked):
    scene = tracked(noise_px=0.2, missing=0.1)
    start = disturbed(scene.poses)
    found = adjust_bundle(scene.tracks, start, scene.intrinsics, 1.0, refine_focal=False)
    np.testing.assert_array_equal(found.intrinsics, scene.intrinsics)
    np.testing.assert_allclose(found.world_to_camera[scene.tracks.reference], np.eye(4), atol=1e-12)
    turn, path = errors(found.world_to_camera, scene.poses)
    assert turn < 0.06
    assert path < 0.03
    assert turn < 0.2 * errors(start, scene.poses)[0]


def test_poses_in_any_frame_and_unit_give_the_same(tracked):
    scene = tracked(noise_px=0.2)
    start = disturbed(scene.poses)
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = Rotation.from_rotvec((1, 2, 3)).as_matrix(), (5, -1, 2)
    elsewhere = start.copy()
    elsewhere[:, :3, 3] *= 20
    one = adjust_bundle(scene.tracks, start, scene.intrinsics, 1.0, refine_focal=False)
    two = adjust_bundle(scene.tracks, elsewhere @ frame, scene.intrinsics, 1.0, refine_focal=False)
    np.testing.assert_allclose(one.world_to_camera, two.world_to_camera, atol=1e-4)


def test_a_wrong_focal_length_is_found_where_it_may_change(tracked):
    scene = tracked(noise_px=0.1, points=500)
    wrong = np.diag([0.9, 0.9, 1]) @ scene.intrinsics
    wrong[:2, 2] = scene.intrinsics[:2, 2]
    found = adjust_bundle(scene.tracks, scene.poses, wrong, 1.0, refine_focal=True)
    assert abs(found.intrinsics[0, 0] - 300) < abs(wrong[0, 0] - 300) / 2
    np.testing.assert_array_equal(found.intrinsics[:2, 2], scene.intrinsics[:2, 2])


def test_pixels_that_are_not_square_keep_their_shape(tracked):
    scene = tracked(noise_px=0.0)
    oblong = np.array([[300.0, 0, 160], [0, 390, 125], [0, 0, 1]])
    corners = scene.tracks.positions[:, scene.tracks.reference]
    positions = predict_positions(corners, scene.inverse_depth, scene.poses, oblong)
    tracks = Tracks(positions, scene.tracks.reference)
    found = adjust_bundle(tracks, disturbed(scene.poses), oblong, 1.0, refine_focal=False)
    turn, path = errors(found.world_to_camera, scene.poses)
    assert turn < 1e-3
    assert path < 1e-3
    assert found.intrinsics[1, 1] / found.intrinsics[0, 0] == pytest.approx(1.3)


def test_the_same_tracks_give_the_same_poses(tracked):
    scene = tracked(noise_px=0.2)
    one, two = (
        adjust_bundle(scene.tracks, disturbed(scene.poses), scene.intrinsics, 1.0, refine_focal=True) for _ in range(2)
    )
    np.testing.assert_array_equal(one.world_to_camera, two.world_to_camera)


def test_a_planar_scene_stays_finite(tracked):
    scene = tracked(noise_px=0.1)
    flat = predict_positions(
        scene.tracks.positions[:, scene.tracks.reference], np.ones(300), scene.poses, scene.intrinsics
    )
    found = adjust_bundle(
        Tracks(flat, scene.tracks.reference), disturbed(scene.poses), scene.intrinsics, 1.0, refine_focal=True
    )
    assert np.isfinite(found.world_to_camera).all()


@pytest.mark.parametrize("still", ["zero motion", "rotation only"])
def test_poses_that_do_not_move_place_no_points(tracked, still):
    poses = tracked().poses.copy()
    poses[:, :3, 3] = 0
    if still == "zero motion":
        poses[:] = np.eye(4)
    scene = tracked(poses=poses)
    with pytest.raises(GeometryError, match="at infinity or behind"):
        adjust_bundle(scene.tracks, poses, scene.intrinsics, 1.0, refine_focal=False)


def test_tracks_of_a_camera_at_rest_under_moving_poses_stay_finite(tracked):
    """Poses that claim a motion that the tracks do not show."""
    scene = tracked()
    still = np.repeat(scene.tracks.positions[:, [scene.tracks.reference]], 8, axis=1)
    still += 0.05 * np.random.default_rng(0).normal(size=still.shape)
    try:
        found = adjust_bundle(
            Tracks(still, scene.tracks.reference), scene.poses, scene.intrinsics, 1.0, refine_focal=True
        )
    except GeometryError:
        return
    assert np.isfinite(found.world_to_camera).all()


def test_a_view_that_sees_nothing_keeps_its_pose(tracked):
    scene = tracked()
    positions = scene.tracks.positions.copy()
    positions[:, 0] = np.nan
    found = adjust_bundle(
        replace(scene.tracks, positions=positions), scene.poses, scene.intrinsics, 1.0, refine_focal=False
    )
    turn, path = errors(found.world_to_camera, scene.poses)
    assert turn < 1e-2
    assert path < 1e-2


def test_errors_in_the_middle_view_harm_less_than_where_its_sightings_are_taken_for_exact(tracked):
    anchored, freed = [], []
    for seed in range(6):
        scene = tracked(seed=seed)
        noise = 0.2 * np.random.default_rng(seed).normal(size=scene.tracks.positions.shape)
        noise[:, scene.tracks.reference] *= 5
        tracks = Tracks(scene.tracks.positions + noise, scene.tracks.reference)
        motion, kept = estimate_motion(tracks, scene.intrinsics)
        found = adjust_bundle(kept, motion.world_to_camera, scene.intrinsics, 1.0, refine_focal=False)
        anchored.append(trajectory_errors(motion.world_to_camera, scene.poses).nate)
        freed.append(trajectory_errors(found.world_to_camera, scene.poses).nate)
    assert np.median(np.array(freed) / np.array(anchored)) < 0.9


def test_what_the_solver_thinks_of_a_step_stays_off_the_terminal(capfd):
    """Cameras that all but stand in one place leave it no two to fix the gauge by, which it has a warning for."""
    rng = np.random.default_rng(0)
    intrinsics = np.array([[300.0, 0, 160], [0, 300.0, 120], [0, 0, 1]])
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = (1e-10, 0.0, -1e-10)
    corners = rng.uniform((5, 5), (315, 235), (60, 2))
    tracks = Tracks(predict_positions(corners, rng.uniform(0.5, 1.5, 60), poses, intrinsics), 1)
    adjust_bundle(tracks, poses, intrinsics, 1.0, refine_focal=False)
    assert capfd.readouterr().err == ""


def test_points_that_all_lie_behind_a_camera_are_refused(tracked, monkeypatch):
    scene = tracked()

    def behind(*arguments):
        start, kept = place_points(*arguments)
        return replace(start, least_depth=-start.least_depth), kept

    monkeypatch.setattr(bundle, "place_points", behind)
    with pytest.raises(GeometryError, match="every tracked point behind a camera"):
        adjust_bundle(scene.tracks, scene.poses, scene.intrinsics, 1.0, refine_focal=False)


def test_a_solver_that_gives_up_is_refused(tracked, monkeypatch):
    scene, helpless = tracked(), SimpleNamespace(solve=lambda: SimpleNamespace(is_solution_usable=lambda: False))
    monkeypatch.setattr(bundle.pycolmap, "create_default_bundle_adjuster", lambda *_: helpless)
    with pytest.raises(GeometryError, match="no finite solution"):
        adjust_bundle(scene.tracks, scene.poses, scene.intrinsics, 1.0, refine_focal=False)
