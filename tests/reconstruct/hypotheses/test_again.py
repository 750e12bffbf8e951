"""When a doubtful path is sought again, what stays of the doubt, and which of two attempts is handed over."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from gs2ci.core.findings import Code, finding
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.fit.withheld import Withheld
from gs2ci.reconstruct.geometry.initialise import PLANE_NOTE, Geometry, GeometrySettings
from gs2ci.reconstruct.hypotheses.again import is_wanted, second_look
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.settings import Settings

UNCERTAIN = finding(Code.PATH_UNCERTAIN, share=0.1)


def geometry(**parts):
    given = Geometry(
        world_to_camera=np.tile(np.eye(4), (5, 1, 1)),
        intrinsics=np.array([[100.0, 0, 60], [0, 100, 45], [0, 0, 1]]),
        focal_source="file",
        inverse_depth=np.ones((90, 120), np.float32),
        reference=2,
        tracks=50,
        reprojection_rms_px=0.1,
        parallax_px=1.0,
        verdict="full",
        notes=(UNCERTAIN,),
        path_error_expected=0.01,
    )
    return replace(given, **parts)


@pytest.mark.parametrize(
    ("parts", "wanted"),
    [
        ({}, False),
        ({"path_error_expected": None}, False),
        ({"path_error_expected": 0.2}, True),
        ({"source": "stage", "path_error_expected": None}, False),
        ({"verdict": "unsupported", "path_error_expected": None}, True),
        ({"verdict": "rotation_only", "path_error_expected": None}, True),
        ({"verdict": "static", "path_error_expected": None}, True),
        ({"verdict": "static", "source": "stage", "path_error_expected": None}, False),
    ],
)
def test_a_path_that_nothing_bears_out_or_that_was_not_found_is_worth_a_second_look(parts, wanted):
    assert is_wanted(geometry(**parts), GeometrySettings()) is wanted


def test_it_is_left_out_where_nothing_could_judge_it_or_parts_are_withheld():
    usual = Settings()
    assert usual.may_look_again
    assert not replace(usual, look_again=False).may_look_again
    assert not replace(usual, withheld=Withheld(poses=True)).may_look_again
    unjudged = replace(usual.fit.hold_out, share=0.0)
    assert not replace(usual, fit=replace(usual.fit, hold_out=unjudged)).may_look_again


@pytest.fixture
def panned():
    """Make views of a wall and a board before it, and their measurement, from a camera that moves to the side."""
    rng = np.random.default_rng(0)
    wall, board = (np.kron(rng.random((60, 90, 3)), np.ones((3, 3, 1))).astype(np.float32) for _ in range(2))
    views = []
    for view in range(5):
        shown = wall[:90, 20 + view : 140 + view].copy()
        shown[25:65, 40:80] = board[25:65, 40 + 4 * view : 80 + 4 * view]
        views.append(shown)
    return np.stack(views)


@pytest.fixture
def first(panned):
    masks = (np.random.default_rng(1).random(panned.shape[:3]) < 0.5).astype(np.float32)
    measurement = np.einsum("nhw,nhwc->hwc", masks, panned)
    shot = Shot(measurement, masks, np.ones(5, np.float32), intrinsics=geometry().intrinsics).check()
    return FirstLook(Holdout.of(shot, 0.02, 0), panned, geometry(path_error_expected=0.2), None)


def test_the_path_is_found_in_the_views_and_the_doubt_stays(first, panned):
    again = second_look(first, panned, None, Settings(), Silent())
    assert again is not None
    assert again.holdout is first.holdout
    assert again.geometry.verdict == "full"
    assert np.linalg.norm(again.geometry.world_to_camera[-1, :3, 3]) > 0
    # Fitted views are those of one rigid scene: that their tracks agree proves nothing.
    assert (again.geometry.source, again.geometry.path_error_expected) == ("tracks", 0.2)
    assert again.geometry.notes[0] == UNCERTAIN
    assert again.geometry.notes[-1].code is Code.PATH_FOUND_AGAIN


def test_views_that_show_no_path_leave_the_first(first, panned):
    assert second_look(first, np.full_like(panned, 0.5), None, Settings(), Silent()) is None


@pytest.mark.parametrize("verdict", ["rotation_only", "static", "unsupported"])
def test_a_path_that_was_not_found_is_found_in_the_views_of_a_fit_with_both_orders_of_depth(first, panned, verdict):
    without = replace(first, geometry=geometry(verdict=verdict, notes=(PLANE_NOTE,), path_error_expected=None))
    again = second_look(without, panned, None, Settings(), Silent())
    assert again is not None
    found = again.geometry
    assert found.verdict == "full"
    assert np.linalg.norm(found.world_to_camera[-1, :3, 3]) > 0
    # Its order is left open.
    assert found.order_errors is None
    assert PLANE_NOTE not in found.notes
    assert found.notes[-1] == finding(Code.PATH_FOUND_IN_FIT, parallax_px=found.parallax_px)


def test_views_of_a_camera_that_only_turned_show_no_path(first, panned):
    matrix, turned = geometry().intrinsics, []
    picture = cv2.GaussianBlur(panned[2], (0, 0), 1.0).astype(np.float64)
    rays = np.linalg.inv(matrix) @ np.stack([*np.indices((90, 120))[::-1], np.ones((90, 120))]).reshape(3, -1)
    for view in range(len(panned)):
        turn = Rotation.from_euler("y", 0.5 * (view - 2), degrees=True).as_matrix()
        right, down, ahead = matrix @ turn.T @ rays
        # By splines at exact places: rounded to a 32nd of a pixel and mixed linearly, as OpenCV does, pictures would
        # show a parallax of their own, of as much as counts here.
        colours = [
            map_coordinates(colour, (down / ahead, right / ahead), mode="mirror")
            for colour in np.moveaxis(picture, -1, 0)
        ]
        turned.append(np.stack(colours, axis=-1).reshape(panned[0].shape).astype(np.float32))
    # Noise as of a fit, independent from view to view.
    views = np.stack(turned) + 0.02 * np.random.default_rng(2).standard_normal(panned.shape).astype(np.float32)
    shot = first.holdout.shot
    coded = np.einsum("nhw,nhwc->hwc", shot.masks, views).astype(np.float32)
    without = replace(
        first,
        holdout=Holdout.of(replace(shot, measurement=coded), 0.02, 0),
        geometry=geometry(verdict="rotation_only", path_error_expected=None),
    )
    assert second_look(without, views, None, Settings(), Silent()) is None
