"""What is said of a result beyond what its stages say."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gs2ci.core.findings import Code
from gs2ci.reconstruct.fusion import Recovered
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.record import _depth_in_noise, _path_unconfirmed

SHAPE = (1, 2, 2, 3)
GREY = SimpleNamespace(grey_rms=lambda: 0.2)
FOUND = Geometry(
    np.tile(np.eye(4), (2, 1, 1)), np.eye(3), "file", np.ones((4, 4), np.float32), 0, 50, 0.3, 2.0, "full", ()
)


def left(rms):
    return Recovered(np.zeros((2, 4, 4, 1), np.float32), "refined", {"refined": rms, "scene": 9.0, "decode": 9.0}, ())


def test_a_depth_behind_views_that_hardly_explain_the_measurement_is_doubted():
    (note,) = _depth_in_noise(FOUND, GREY, left(0.12))
    assert note.code is Code.DEPTH_IN_NOISE
    assert "60%" in note.sentence
    assert "Near and far may be exchanged" in note.sentence


@pytest.mark.parametrize("rms", [0.09, None])
def test_one_behind_views_that_explain_it_or_that_nobody_judged_is_not(rms):
    assert _depth_in_noise(FOUND, GREY, left(rms)) == ()


@pytest.mark.parametrize(
    "given", [{"verdict": "static"}, {"source": "stage"}, {"source": "file"}, {"order_given": True}]
)
def test_nor_one_that_is_none_or_whose_path_was_given(given):
    assert _depth_in_noise(replace(FOUND, **given), GREY, left(0.12)) == ()


def test_where_a_grey_leaves_nothing_there_is_nothing_to_compare_with():
    assert _depth_in_noise(FOUND, SimpleNamespace(grey_rms=lambda: 0.0), left(0.12)) == ()


def beside_decode(scene, decode):
    return replace(left(0.1), heldout_rms={"refined": 0.1, "scene": scene, "decode": decode})


def test_a_path_along_which_the_scene_explains_less_than_the_decode_is_doubted():
    (note,) = _path_unconfirmed(FOUND, beside_decode(0.13, 0.1), None)
    assert note.code is Code.PATH_UNCONFIRMED
    assert "30% larger" in note.sentence


@pytest.mark.parametrize(("scene", "decode"), [(0.1, 0.1), (0.07, 0.1), (None, None), (0.1, None), (0.1, 0.0)])
def test_one_along_which_it_explains_as_much_or_that_nobody_judged_is_not(scene, decode):
    assert _path_unconfirmed(FOUND, beside_decode(scene, decode), None) == ()


def test_where_there_is_no_path_none_is_doubted():
    assert _path_unconfirmed(replace(FOUND, verdict="static"), beside_decode(0.13, 0.1), None) == ()


@pytest.mark.parametrize(
    ("turn", "brief", "doubted"), [(0.3, 0.12, False), (0.3, 0.1, True), (0.3, None, True), (0.2, 0.12, True)]
)
def test_a_scene_whose_camera_turned_far_is_compared_with_the_brief_decode(turn, brief, doubted):
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, :3:2, :3:2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    found = _path_unconfirmed(replace(FOUND, world_to_camera=poses), beside_decode(0.13, 0.08), brief)
    assert bool(found) == doubted


def fit_of(in_the_middle, over_the_time):
    """A fit whose scene looks everywhere like this at the middle of each mask's time, and over the whole of it."""
    views = np.full(SHAPE, over_the_time, np.float32)
    return SimpleNamespace(scene=in_the_middle, views=views, world_to_camera=np.eye(4)[None])


@pytest.mark.parametrize(
    ("parts", "delivered"),
    [
        ({"scene": 1.0}, 0.5),
        ({"refined": 1.0}, 0.7),
        ({"decode": 1.0}, 0.4),
        ({"refined": 0.2, "scene": 0.3, "decode": 0.5}, 0.49),
    ],
)
def test_views_at_the_middle_of_the_masks_are_corrected_by_the_scenes_that_they_are_made_of(parts, delivered):
    renderer = SimpleNamespace(
        moments_per_mask=3, times=None, views=lambda scene, poses, times: np.full(SHAPE, scene, np.float32)
    )
    ensemble = SimpleNamespace(best=fit_of(0.5, 0.4), others=(fit_of(0.9, 0.4), fit_of(7.0, 0.4)), averaged=2)
    exposed = np.full(SHAPE, 0.4, np.float32)
    found = Recovered(exposed, "refined", {}, (), parts=parts).in_the_middle(ensemble, renderer)
    np.testing.assert_allclose(found.views, delivered, rtol=1e-6)
    np.testing.assert_allclose(found.scene_views, 0.5, rtol=1e-6)
    assert found.views.dtype == np.float32
    assert found.exposed is exposed


def test_masks_of_one_moment_need_no_correction():
    given = left(0.1)
    assert given.in_the_middle(SimpleNamespace(), SimpleNamespace(moments_per_mask=1)) is given
