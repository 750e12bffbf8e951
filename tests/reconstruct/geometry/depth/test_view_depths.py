"""Depths of several views of a path that turns far: which views, and against the true planes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.reconstruct.geometry.depth import view_depths as module
from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings
from gs2ci.reconstruct.geometry.depth.view_depths import (
    ViewDepth,
    agreement,
    depths_agree,
    known,
    largest_turn_deg,
    turns_far,
    view_depths,
)
from gs2ci.reconstruct.geometry.path.motion import rays
from tests.reconstruct.geometry.orbits import PLACES, around

QUICK = SweepSettings(planes=48)
REFERENCE = 2


@pytest.fixture(scope="module")
def scene(seen):
    return seen(poses=around(PLACES, 1.0), size=(90, 120), focal=100.0)


def directions(scene):
    height, width = scene.views.shape[1:3]
    down, right = np.mgrid[0:height, 0:width]
    return rays(np.stack([right.ravel(), down.ravel()], axis=1) + 0.5, scene.intrinsics)


def points_of(scene):
    return directions(scene) / scene.inverse_depth.reshape(-1, 1)


def true_depth(scene, view):
    """Inverse depth of the panel where a view's rays meet it, otherwise of the wall, [H, W]."""
    pose = scene.poses[view]
    centre, ahead = -pose[:3, :3].T @ pose[:3, 3], directions(scene) @ pose[:3, :3]
    height, width = scene.inverse_depth.shape
    depths = []
    for inverse in (scene.inverse_depth.max(), scene.inverse_depth.min()):
        depths.append((1 / inverse - centre[2]) / ahead[:, 2])
    seen = (centre + depths[0][:, None] * ahead) @ scene.intrinsics.T
    column, row = (seen[:, :2] / seen[:, 2:]).T
    panel = (abs(column / width - 0.5) < 0.25) & (abs(row / height - 0.5) < 0.25)
    return 1 / np.where(panel, *depths).reshape(height, width)


def swept(scene):
    return view_depths(scene.views, scene.poses, scene.intrinsics, REFERENCE, points_of(scene), QUICK)


def test_the_depth_of_every_view_is_that_of_the_planes_it_sees(scene):
    found = swept(scene)
    assert found[0].view == REFERENCE
    assert {one.view for one in found} == set(range(5))
    for one in found:
        ratio = one.inverse_depth / true_depth(scene, one.view)
        assert one.inverse_depth.dtype == np.float32
        assert abs(np.median(ratio) - 1) < 0.02
        assert np.mean(abs(ratio - 1) < 0.1) > 0.75


def test_the_views_turned_farthest_are_swept_with_those_turned_least_against_them(scene, monkeypatch):
    monkeypatch.setattr(module, "_MOST_SWEPT", 2)
    monkeypatch.setattr(module, "NEIGHBOURS", 1)
    asked = []

    class Asked:
        def __init__(self, views, settings):
            np.testing.assert_array_equal(views, scene.views)
            assert settings == QUICK

        def depth(self, order, poses, intrinsics, span):
            asked.append((order, poses))
            return np.ones(scene.views.shape[1:3], np.float32)

    monkeypatch.setattr(module, "SweptViews", Asked)
    assert [one.view for one in swept(scene)] == [2, 4]
    for (order, poses), (own, other) in zip(asked, [(2, 3), (4, 1)], strict=True):
        assert order == [own, other]
        np.testing.assert_allclose(poses[0], np.eye(4), atol=1e-12)
        np.testing.assert_allclose(poses[1] @ scene.poses[own], scene.poses[other], atol=1e-12)


def test_a_view_with_all_points_behind_it_is_left_out(scene):
    poses = scene.poses.copy()
    poses[0, :3, :3] = Rotation.from_euler("y", 180, degrees=True).as_matrix() @ poses[0, :3, :3]
    poses[0, :3, 3] = 0
    found = view_depths(scene.views, poses, scene.intrinsics, REFERENCE, points_of(scene), QUICK)
    assert found[0].view == REFERENCE
    assert {one.view for one in found} == {1, 2, 3, 4}


@pytest.mark.parametrize(
    ("degrees", "far"), [((0, 0, 0), False), ((0, 7, 14), False), ((8, 0, -8), True), ((0, 90, 180), True)]
)
def test_a_path_turns_far_if_any_two_views_do(degrees, far):
    poses = np.tile(np.eye(4), (len(degrees), 1, 1))
    poses[:, :3, :3] = Rotation.from_euler("y", np.array(degrees)[:, None], degrees=True).as_matrix()
    assert turns_far(poses) is far


def test_a_camera_that_turns_about_its_viewing_direction_sees_the_same_surfaces(scene):
    roll = Rotation.from_euler("z", np.linspace(0, 90, len(scene.poses))[:, None], degrees=True).as_matrix()
    along = np.tile(np.eye(4), (len(roll), 1, 1))
    along[:, :3, :3] = roll
    assert not turns_far(along)
    rolled = along @ scene.poses
    assert largest_turn_deg(rolled) == pytest.approx(largest_turn_deg(scene.poses))


def true_depths(scene):
    return tuple(ViewDepth(view, true_depth(scene, view).astype(np.float32)) for view in range(len(scene.poses)))


def test_depths_of_the_same_surfaces_agree(scene):
    # What one view sees of the wall is hidden from others by the panel.
    assert agreement(true_depths(scene), scene.poses, scene.intrinsics) > 0.8
    found = swept(scene)
    assert agreement(found, scene.poses, scene.intrinsics) > 0.4
    assert depths_agree(found, scene.poses, scene.intrinsics)


def test_depths_along_a_wrong_path_agree_hardly_more_than_at_random(scene):
    poses = np.concatenate([scene.poses[2:], scene.poses[:2]])
    found = view_depths(scene.views, poses, scene.intrinsics, REFERENCE, points_of(scene), QUICK)
    assert not depths_agree(found, poses, scene.intrinsics)


def test_depths_at_random_agree_by_chance_alone(scene):
    draw = np.random.default_rng(1)
    height, width = scene.inverse_depth.shape
    drawn = tuple(
        ViewDepth(view, draw.uniform(0.5, 1.5, (height, width)).astype(np.float32)) for view in range(len(scene.poses))
    )
    assert abs(agreement(drawn, scene.poses, scene.intrinsics)) < 0.02


@pytest.mark.parametrize("count", [0, 1])
def test_nothing_agrees_with_a_single_view(scene, count):
    assert agreement(true_depths(scene)[:count], scene.poses, scene.intrinsics) == 0
    assert not depths_agree(true_depths(scene)[:count], scene.poses, scene.intrinsics)


def test_views_that_look_away_from_each_other_share_no_surface(scene):
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, :3, :3] = Rotation.from_euler("y", 180, degrees=True).as_matrix()
    depths = tuple(ViewDepth(view, np.ones(scene.inverse_depth.shape, np.float32)) for view in range(2))
    assert agreement(depths, poses, scene.intrinsics) == 0


def test_a_point_is_known_where_a_view_shows_its_surface(scene):
    depth = ViewDepth(REFERENCE, scene.inverse_depth)
    points = points_of(scene)[::97]
    for scale, lies in ((1.0, True), (1.02, True), (1.05, False), (-1.0, False)):
        found = known(points * scale, depth, scene.poses, scene.intrinsics)
        assert found.shape == (len(points),)
        assert (found == lies).all()
