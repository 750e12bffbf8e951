import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct.geometry.path.halves import (
    cells,
    expected_path_error,
    squared_distance,
    squared_turn,
    times_better_foretold,
)
from gs2ci.reconstruct.geometry.path.motion import (
    Sightings,
    adjust,
    estimate_motion,
    predict_positions,
    start_motion,
    wander_px,
)
from gs2ci.reconstruct.geometry.path.telemetry import place_points
from gs2ci.reconstruct.geometry.tracks.tracks import Tracks

SIZE = (240, 320)


def expected(scene):
    motion, kept = estimate_motion(scene.tracks, scene.intrinsics)
    return expected_path_error(motion, kept, scene.intrinsics, SIZE)


def at_rest(scene):
    return start_motion(Sightings.of(scene.tracks, scene.intrinsics))


def in_part_of_the_frame(scene, share, noise_px, seed=0):
    """The scene's points moved into a part of the frame of this width and height, with noise."""
    rng, tracks = np.random.default_rng(seed), scene.tracks
    corners = (np.array(SIZE[::-1]) / 2) * (1 - share) + share * tracks.positions[:, tracks.reference]
    positions = predict_positions(corners, scene.inverse_depth, scene.poses, scene.intrinsics)
    positions += noise_px * rng.normal(size=positions.shape)
    positions[:, tracks.reference] = corners
    return type(scene)(Tracks(positions, tracks.reference), scene.intrinsics, scene.poses, scene.inverse_depth)


def random_path(rng, views=7):
    poses = np.tile(np.eye(4), (views, 1, 1))
    poses[:, :3, :3] = Rotation.random(views, random_state=3).as_matrix()
    poses[:, :3, 3] = rng.normal(size=(views, 3))
    return poses


def centres_of(poses):
    return np.linalg.inv(poses)[:, :3, 3]


@pytest.mark.parametrize("noise_px", [0.3, 1.0])
@pytest.mark.parametrize("points", [60, 300])
def test_independent_noise_gives_the_true_error_within_a_factor_of_two(tracked, points, noise_px):
    true, said = [], []
    for seed in range(6):
        scene = tracked(seed=seed, points=points, noise_px=noise_px)
        motion, kept = estimate_motion(scene.tracks, scene.intrinsics)
        true.append(trajectory_errors(motion.world_to_camera, scene.poses).nate)
        said.append(expected_path_error(motion, kept, scene.intrinsics, SIZE))
    assert 0.5 < np.median(np.array(true) / np.array(said)) < 2


def test_exact_tracks_leave_nothing_open(tracked):
    assert expected(tracked()) < 0.005


def test_points_on_a_small_part_of_the_frame_leave_the_path_open(tracked):
    scene = tracked(points=100)
    wide, narrow = (expected(in_part_of_the_frame(scene, share, noise_px=0.7)) for share in (1.0, 0.25))
    assert narrow > 3 * wide


def test_errors_that_neighbours_share_count_for_more_than_their_own(tracked):
    scene, rng = tracked(), np.random.default_rng(0)
    positions, reference = scene.tracks.positions, scene.tracks.reference
    cell = (positions[:, reference] // 40).astype(int) @ [1, 8]
    shared = 0.5 * rng.normal(size=(cell.max() + 1, *positions.shape[1:]))[cell]
    own = 0.5 * rng.normal(size=positions.shape)
    shared[:, reference] = own[:, reference] = 0
    said = [
        expected(type(scene)(Tracks(positions + noise, reference), scene.intrinsics, scene.poses, scene.inverse_depth))
        for noise in (own, shared)
    ]
    assert said[1] > 1.3 * said[0]


def test_the_same_tracks_give_the_same_bits(tracked):
    scene = tracked(noise_px=0.5)
    assert expected(scene) == expected(scene)


def test_no_tracks_say_nothing(tracked):
    scene = tracked(points=5)
    none = scene.tracks.keep(np.zeros(5, bool))
    motion = start_motion(Sightings.of(none, scene.intrinsics))
    assert expected_path_error(motion, none, scene.intrinsics, SIZE) is None


@pytest.mark.parametrize("views", [1, 2])
def test_fewer_than_three_views_have_no_path_to_compare(tracked, views):
    scene = tracked(views=views, noise_px=0.5)
    assert expected_path_error(at_rest(scene), scene.tracks, scene.intrinsics, SIZE) is None


def test_a_camera_that_stays_where_it_is_has_no_path(tracked):
    scene = tracked()
    assert expected_path_error(at_rest(scene), scene.tracks, scene.intrinsics, SIZE) is None


@pytest.mark.parametrize("noise_px", [0.0, 0.5])
def test_a_camera_that_only_turned_is_finite_and_doubtful(tracked, path, noise_px):
    poses = path(8, np.random.default_rng(1), length=0.0, turn=0.05)
    said = expected(tracked(poses=poses, noise_px=noise_px))
    assert 0.05 < said <= 1


def test_a_plane_is_finite(tracked):
    scene = tracked(noise_px=0.3)
    flat = predict_positions(
        scene.tracks.positions[:, scene.tracks.reference],
        np.ones_like(scene.inverse_depth),
        scene.poses,
        scene.intrinsics,
    )
    plane = type(scene)(
        Tracks(flat, scene.tracks.reference), scene.intrinsics, scene.poses, np.ones_like(scene.inverse_depth)
    )
    assert 0 <= expected(plane) <= 1


@pytest.mark.parametrize("points", [1, 3, 40])
def test_tracks_in_one_cell_have_a_half_without_any(tracked, points):
    scene = in_part_of_the_frame(tracked(points=points), 0.02, noise_px=0.2)
    scene.tracks.positions[:] += 10  # off the corner of four cells
    assert 0.1 < expected(scene) <= 1


def test_views_that_see_nothing_do_not_count(tracked):
    scene = tracked(noise_px=0.5)
    before = expected(scene)
    scene.tracks.positions[:, 0] = np.nan
    assert expected(scene) == pytest.approx(before, rel=1.0)
    assert expected(scene) > 0


def looking_as(path, other):
    """Turn the cameras of another path so that they look as this path's do once their centres lie best on its own.

    The evaluation lets the orientations decide where centres fit only with the cameras turned over.
    """
    at, there = centres_of(path), centres_of(other)
    turn, _ = Rotation.align_vectors(at - at.mean(0), there - there.mean(0))
    looking = other.copy()
    looking[:, :3, :3] = path[:, :3, :3] @ turn.as_matrix()
    looking[:, :3, 3] = -np.einsum("nij,nj->ni", looking[:, :3, :3], there)
    return looking


def test_distance_is_that_of_the_evaluation():
    rng = np.random.default_rng(0)
    for _ in range(5):
        path = random_path(rng)
        other = looking_as(path, random_path(rng))
        wanted = trajectory_errors(other, path).ate ** 2
        assert squared_distance(centres_of(other), centres_of(path)) == pytest.approx(wanted, rel=1e-9)


def test_a_similarity_is_no_distance_and_a_mirror_is():
    path = centres_of(random_path(np.random.default_rng(0)))
    turned = 3 * path @ Rotation.from_rotvec([0.3, -1, 2]).as_matrix().T + [1, 2, 3]
    assert squared_distance(turned, path) < 1e-12
    assert squared_distance(path * [1, 1, -1], path) > 0.01


def test_a_half_that_found_no_motion_errs_by_the_whole_path():
    path = centres_of(random_path(np.random.default_rng(0)))
    spread = ((path - path.mean(0)) ** 2).sum(1).mean()
    assert squared_distance(np.zeros_like(path), path) == pytest.approx(spread)


def with_errors_of_neighbours(scene, noise_px, count=14, seed=0):
    """The scene's points in a few cells of the frame; those of one cell err alike in each view."""
    rng, tracks = np.random.default_rng(seed), scene.tracks
    cell = cells(tracks, SIZE)
    here = np.isin(cell, rng.permutation(np.unique(cell))[:count])
    positions = tracks.positions + noise_px * rng.normal(size=(cell.max() + 1, tracks.positions.shape[1], 2))[cell]
    positions[:, tracks.reference] = tracks.positions[:, tracks.reference]
    return Tracks(positions, tracks.reference).keep(here)


def compared(scene, tracks, poses):
    """How many times more given poses leave: than poses adjusted to the same tracks, and to the other half of them."""
    given, _ = place_points(tracks, poses, scene.intrinsics, 1.0, np.inf)
    adjusted = adjust(tracks, scene.intrinsics, start=given)
    same = wander_px(given.errors_px, unknowns=1) / wander_px(adjusted.errors_px, unknowns=1)
    return same, times_better_foretold(given, adjusted, tracks, scene.intrinsics, SIZE)


def test_exact_poses_foretell_half_of_the_tracks_as_well_as_poses_adjusted_to_the_other(tracked):
    """Adjusted to the same tracks, poses follow the errors that neighbours share."""
    same, halves = [], []
    for seed in range(8):
        scene = tracked(seed=seed, points=300)
        one, other = compared(scene, with_errors_of_neighbours(scene, 0.5, seed=seed), scene.poses)
        same.append(one)
        halves.append(other)
    assert np.median(same) > 1.1
    assert np.median(halves) < 1
    assert max(halves) < 1.05


def test_wrong_places_foretell_tracks_worse_than_their_other_half_does(tracked):
    for seed in range(4):
        scene, rng = tracked(seed=seed, points=300), np.random.default_rng(seed)
        wrong = scene.poses.copy()
        extent = np.linalg.norm(np.ptp(centres_of(wrong), axis=0))
        wrong[:, :3, 3] += 0.1 * extent * rng.normal(size=(len(wrong), 3))
        _, halves = compared(scene, with_errors_of_neighbours(scene, 0.5, seed=seed), wrong)
        assert halves > 1.2


def test_halves_without_a_track_or_with_points_behind_foretell_nothing(tracked):
    scene = tracked(points=60)
    given, tracks = place_points(scene.tracks, scene.poses, scene.intrinsics, 1.0, np.inf)
    none = np.zeros(len(tracks), bool)
    nothing = type(given)(**{**vars(given), "inverse_depth": given.inverse_depth[none]})
    assert times_better_foretold(nothing, nothing, tracks.keep(none), scene.intrinsics, SIZE) == 0
    backwards = type(given)(**{**vars(given), "translations": -given.translations})
    assert times_better_foretold(backwards, given, tracks, scene.intrinsics, SIZE) == np.inf


def test_turns_are_counted_beyond_the_one_that_all_cameras_have_in_common():
    path = random_path(np.random.default_rng(0))
    common, own = Rotation.from_euler("yx", [40, -10], degrees=True), np.radians([3, -3, 2, -2, 0, 1, -1])
    poses = path.copy()
    about_x = Rotation.from_rotvec(own[:, None] * [1, 0, 0])
    poses[:, :3, :3] = path[:, :3, :3] @ (common * about_x).inv().as_matrix()
    assert squared_turn(poses, path) == pytest.approx(np.square(own).mean(), rel=1e-6)
    poses[:, :3, :3] = path[:, :3, :3] @ common.as_matrix()
    assert squared_turn(poses, path) < 1e-12
