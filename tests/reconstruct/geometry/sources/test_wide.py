"""Features matched between all pairs of views: far apart and in no order, and where they show nothing."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import GeometryError
from gs2ci.core.findings import Code
from gs2ci.core.progress import Silent
from gs2ci.evaluate.trajectory import trajectory_errors
from gs2ci.reconstruct.geometry.choose import load_geometry_prior
from gs2ci.reconstruct.geometry.depth.sweep import SweepSettings
from gs2ci.reconstruct.geometry.initialise import GeometrySettings, initialise
from gs2ci.reconstruct.geometry.prior import Request
from gs2ci.reconstruct.geometry.sources import mapper, wide
from gs2ci.reconstruct.geometry.sources.mapper import MappedScene
from gs2ci.reconstruct.geometry.sources.wide import wide_motion
from tests.reconstruct.geometry.orbits import PLACES, around

QUICK = GeometrySettings(sweep=SweepSettings(planes=24))


@pytest.fixture(scope="module")
def scene(seen):
    return seen(poses=around(PLACES, 1.0), size=(135, 180), focal=150.0)


@pytest.fixture
def request_for(scene, expose):
    return lambda views=None: Request(expose(scene), scene.views if views is None else views, QUICK)


@pytest.fixture(scope="module")
def grown(scene):
    return wide._grown(scene.views, scene.intrinsics, tilted=False)


def flat(request):
    return replace(initialise(np.full_like(request.views, 0.5), request.intrinsics, QUICK))


def test_views_far_apart_and_in_no_order_join_one_scene(request_for, scene):
    request = request_for()
    found = wide_motion(request, flat(request))
    assert found.verdict == "full"
    assert [note.code for note in found.notes] == [Code.WIDE_MOTION]
    errors = trajectory_errors(found.world_to_camera, scene.poses)
    assert errors.nate < 0.03
    assert errors.rotation_deg < 1.0
    np.testing.assert_allclose(found.world_to_camera[found.reference], np.eye(4), atol=1e-9)
    assert 0.7 < np.median(found.inverse_depth) < 1.4
    # They turn by 20°: each view's depth is swept, and the order of depth is sure.
    assert [found.view_depths[0].view, len(found.view_depths)] == [found.reference, len(PLACES)]
    np.testing.assert_array_equal(found.view_depths[0].inverse_depth, found.inverse_depth)
    assert all(0.7 < np.median(one.inverse_depth) < 1.4 for one in found.view_depths)
    assert found.order_errors >= QUICK.criteria.order_errors
    assert 0 < found.path_error_expected < 0.03
    again = wide_motion(request, flat(request))
    np.testing.assert_array_equal(again.world_to_camera, found.world_to_camera)


def test_views_of_a_dark_scene_join_as_those_of_a_bright_one(request_for, scene):
    request = request_for(scene.views / np.float32(64))
    found = wide_motion(request, flat(request))
    assert found.verdict == "full"
    assert trajectory_errors(found.world_to_camera, scene.poses).nate < 0.03


@pytest.mark.parametrize("what", ["plain", "noise", "one view of something else"])
def test_views_that_do_not_all_join_leave_a_camera_at_rest(request_for, scene, what):
    rng = np.random.default_rng(0)
    views = {
        "plain": np.full_like(scene.views, 0.5),
        "noise": rng.random((5, 48, 64, 3)).astype(np.float32),
        "one view of something else": scene.views.copy(),
    }[what]
    if what.startswith("one"):
        views[1] = rng.random(views[1].shape)
    request = request_for(views)
    found = wide_motion(request, flat(request))
    assert found.verdict == "unsupported"
    np.testing.assert_array_equal(found.world_to_camera, np.tile(np.eye(4), (len(PLACES), 1, 1)))
    with pytest.raises(GeometryError, match="do not join"):
        load_geometry_prior("wide")(request, Silent())


def test_a_path_along_which_depths_of_views_disagree_is_not_taken(request_for, grown, monkeypatch):
    monkeypatch.setattr(wide, "_grown", lambda *_, **__: grown)
    monkeypatch.setattr(wide, "depths_agree", lambda *_: False)
    request = request_for()
    found = wide_motion(request, flat(request))
    assert (found.verdict, found.view_depths) == ("unsupported", ())
    np.testing.assert_array_equal(found.world_to_camera, np.tile(np.eye(4), (len(PLACES), 1, 1)))


def test_views_that_turn_less_have_one_depth_and_an_open_order(expose, scene):
    few = [3, 2, 0]  # 8° from the first to the last
    near = replace(scene, views=scene.views[few], poses=scene.poses[few])
    request = Request(expose(near), near.views, QUICK)
    found = wide_motion(request, flat(request))
    assert (found.verdict, found.view_depths, found.order_errors) == ("full", (), None)


def test_the_source_is_called_by_its_name(request_for, grown, monkeypatch):
    monkeypatch.setattr(wide, "_grown", lambda *_, **__: grown)
    found = load_geometry_prior("wide")(request_for(), Silent())
    assert (found.source, found.verdict) == ("wide", "full")


def test_tilted_pictures_give_more_points_and_the_same_path(request_for, scene, monkeypatch):
    # Scenes of so many points take seconds each.
    monkeypatch.setattr(mapper, "_MOST_STARTS", 2)
    monkeypatch.setattr(wide, "_MOST_TILTED", 15_000)
    request = request_for()
    plain, tilted = (wide_motion(request, flat(request), tilted=also) for also in (False, True))
    assert tilted.verdict == "full"
    assert tilted.tracks > 1.5 * plain.tracks
    assert trajectory_errors(tilted.world_to_camera, scene.poses).nate < 0.03


def test_more_views_share_the_features_of_tilted_pictures(request_for, monkeypatch):
    asked = []
    monkeypatch.setattr(
        wide,
        "find_features",
        lambda view, tilted: asked.append(tilted) or (np.zeros((0, 2), np.float32), np.zeros((0, 128), np.float32)),
    )
    request = request_for()
    assert wide_motion(request, flat(request), tilted=True).verdict == "unsupported"
    assert asked == [64_000 // len(PLACES)] * len(PLACES)


def test_lengths_are_relative_to_the_median_inverse_depth_before_the_middle_view(request_for, scene, monkeypatch):
    """A scene in another unit, whose middle camera stands away from the origin."""
    path = np.tile(np.eye(4), (len(PLACES), 1, 1))
    path[:, :3, 3] = np.array([0.1, 0.0, 0.0]) * np.arange(len(PLACES))[:, None] + (0.0, 0.0, 3.0)
    depths = np.linspace(4.0, 10.0, 301)
    points = np.column_stack([np.zeros_like(depths), np.zeros_like(depths), depths - 3.0])
    spans = []
    mapped = MappedScene(path, points, 0.1, 0.01)
    monkeypatch.setattr(wide, "_grown", lambda *_, **__: mapped)
    monkeypatch.setattr(wide, "turns_far", lambda _: False)
    monkeypatch.setattr(wide, "sweep", lambda *given: spans.append(given[4]) or scene.inverse_depth)
    request = request_for()
    found = wide_motion(request, flat(request))
    centres = np.linalg.inv(found.world_to_camera)[:, 0, 3]
    np.testing.assert_allclose(np.diff(centres), -0.1 / 7.0, rtol=1e-6)
    assert min(spans[0]) < 7.0 / 10.0
    assert 7.0 / 4.0 < max(spans[0]) < 3.0


@pytest.mark.parametrize(("size", "at_once"), [((720, 960), 1), ((360, 480), 6)])
def test_so_many_views_share_the_memory_for_features(monkeypatch, size, at_once):
    """A view of 720 × 960 px takes more than half of it: several at once have one thread each."""
    asked, alone = [], []
    monkeypatch.setattr(wide, "in_threads", lambda _, views, at_most: asked.append(at_most) or [([], [])] * len(views))
    monkeypatch.setattr(wide, "one_opencv_thread", lambda: alone.append(True) or nullcontext())
    monkeypatch.setattr(wide, "match_features", lambda *_: ())
    monkeypatch.setattr(wide, "grown_scene", lambda *_: None)
    assert wide._grown(np.zeros((2, *size, 1), np.float32), np.eye(3), tilted=False) is None
    assert asked == [at_once]
    assert bool(alone) is (at_once > 1)
