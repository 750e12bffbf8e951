"""Scenes grown from matches between all pairs of views: from which pairs, and how sure their path is."""

import itertools

import numpy as np
import pytest

from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct.geometry.sources import mapper
from gs2ci.reconstruct.geometry.sources.mapper import grown_scene
from tests.reconstruct.geometry.orbits import around

SIZE = (240, 320)
INTRINSICS = np.array([[500.0, 0, 160], [0, 500, 120], [0, 0, 1]])
PIVOT = np.array([0.0, 0.0, 5.0])
NOISE_PX = 0.3


POSES = around([(14, 3), (-6, -4), (0, 0), (25, 2), (-20, 5)], 5.0)


def seen_from(poses, points, rng):
    """Places of points in each view, [P, 2] px, with noise."""
    ahead = np.einsum("nij,pj->npi", poses[:, :3, :3], points) + poses[:, None, :3, 3]
    projected = ahead @ INTRINSICS.T
    places = projected[..., :2] / projected[..., 2:]
    return (places + NOISE_PX * rng.standard_normal(places.shape)).astype(np.float32)


def points_of(count, rng):
    return PIVOT + rng.uniform(-1, 1, (count, 3))


def all_pairs(views, numbers):
    return {
        pair: np.stack([numbers, numbers], axis=1).astype(np.uint32) for pair in itertools.combinations(range(views), 2)
    }


def distance(scene):
    return trajectory_errors(scene.world_to_camera, POSES)


def test_a_scene_is_grown_from_matches_of_which_a_third_is_wrong(monkeypatch):
    rng = np.random.default_rng(0)
    places = seen_from(POSES, points_of(120, rng), rng)
    pairs = all_pairs(5, np.arange(120))
    for matches in pairs.values():
        matches[:40, 1] = rng.permutation(matches[:40, 1])
    scene = grown_scene(list(places), pairs, INTRINSICS, SIZE)
    assert distance(scene).nate < 0.01
    assert distance(scene).rotation_deg < 0.5
    assert 70 < len(scene.points) <= 120
    assert NOISE_PX / 2 < scene.rms_px < 2 * NOISE_PX
    assert 0.001 < scene.path_error_expected < 0.02
    monkeypatch.setattr("numba.get_num_threads", lambda: 3)
    again = grown_scene(list(places), pairs, INTRINSICS, SIZE)
    np.testing.assert_array_equal(again.world_to_camera, scene.world_to_camera)
    assert again.path_error_expected == scene.path_error_expected
    monkeypatch.setattr(mapper, "_RIVALS", 2.0)  # no other model explains so many
    assert 0.001 < grown_scene(list(places), pairs, INTRINSICS, SIZE).path_error_expected <= scene.path_error_expected


def test_a_scene_need_not_begin_with_the_pair_of_most_matches(monkeypatch):
    rng = np.random.default_rng(1)
    poses = POSES.copy()
    poses[1] = poses[0]  # two views from one place begin no scene, though all their features match
    places = seen_from(poses, points_of(150, rng), rng)
    pairs = all_pairs(5, np.arange(100))
    pairs[0, 1] = np.stack([np.arange(150)] * 2, axis=1).astype(np.uint32)
    scene = grown_scene(list(places), pairs, INTRINSICS, SIZE)
    assert trajectory_errors(scene.world_to_camera, poses).nate < 0.01
    monkeypatch.setattr(mapper, "_MOST_STARTS", 1)
    assert grown_scene(list(places), pairs, INTRINSICS, SIZE) is None


def test_the_distance_of_a_path_that_explains_hardly_fewer_matches_is_the_expected_error(monkeypatch):
    """Two things that moved in different ways, the one with 80 points, the other with 60."""
    rng = np.random.default_rng(2)
    other = around([(-20, -12), (25, 15), (0, 0), (-6, -9), (14, 9)], 5.0)
    one, two = points_of(80, rng), points_of(60, rng)
    places = np.concatenate([seen_from(POSES, one, rng), seen_from(other, two, rng)], axis=1)
    pairs = {
        pair: matches[20:] if sum(pair) % 2 else matches[:-20] for pair, matches in all_pairs(5, np.arange(140)).items()
    }
    surely = grown_scene(list(places), pairs, INTRINSICS, SIZE)
    assert surely.path_error_expected < 0.02
    monkeypatch.setattr(mapper, "_RIVALS", 0.3)
    in_doubt = grown_scene(list(places), pairs, INTRINSICS, SIZE)
    np.testing.assert_array_equal(in_doubt.world_to_camera, surely.world_to_camera)
    assert in_doubt.path_error_expected > 0.05


@pytest.mark.parametrize("matches", [0, 14])
def test_too_few_matches_begin_nothing(matches):
    rng = np.random.default_rng(3)
    places = seen_from(POSES, points_of(50, rng), rng)
    pairs = all_pairs(5, np.arange(matches)) if matches else {}
    assert grown_scene(list(places), pairs, INTRINSICS, SIZE) is None


def test_matches_are_sought_as_long_as_it_takes_to_find_as_many_right_ones_as_a_pair_needs(monkeypatch):
    confirm, told = mapper.pycolmap.estimate_calibrated_two_view_geometry, {}

    def listening(*given):
        told[len(given[4])] = given[5].ransac.min_inlier_ratio
        return confirm(*given)

    monkeypatch.setattr(mapper.pycolmap, "estimate_calibrated_two_view_geometry", listening, raising=False)
    rng = np.random.default_rng(1)
    places = seen_from(POSES[:3], points_of(60, rng), rng)
    pairs = {(0, 1): 15, (0, 2): 45, (1, 2): 60}
    matches = {pair: np.stack([np.arange(count)] * 2, axis=1).astype(np.uint32) for pair, count in pairs.items()}
    grown_scene(list(places), matches, INTRINSICS, SIZE)
    assert told == {15: 1.0, 45: pytest.approx(1 / 3), 60: 0.25}
