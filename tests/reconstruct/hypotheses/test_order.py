"""Whether the order of depth is settled before fits, and which one is likelier."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gs2ci.core.findings import Code
from gs2ci.reconstruct.geometry.initialise import Geometry, OtherOrder
from gs2ci.reconstruct.geometry.path.validity import Criteria
from gs2ci.reconstruct.geometry.reversal import reversed_geometry
from gs2ci.reconstruct.hypotheses.findings import order_findings
from gs2ci.reconstruct.hypotheses.hypothesis import OrderFound
from gs2ci.reconstruct.hypotheses.order import in_likelier_order, is_open

NEAR_LEFT = np.tile(np.linspace(1.3, 0.7, 128, dtype=np.float32), (96, 1))
CAMERA = np.array([[2000.0, 0, 64], [0, 2000, 48], [0, 0, 1]])


@pytest.fixture
def found():
    """A camera that turns so that the middle of the scene stays put: its travel tells nothing of the order."""
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, 0, 3] = (-0.02, -0.01, 0, 0.01)
    poses[:, :3, :3] = Rotation.from_rotvec(-poses[:, 0, 3, None] * [0.0, 1.0, 0.0]).as_matrix()
    return Geometry(poses, CAMERA, "tracks", NEAR_LEFT, 2, 100, 0.3, 2.0, "full", ())


@pytest.fixture
def carried(found):
    """The same without a turn, as a stage would carry it."""
    poses = found.world_to_camera.copy()
    poses[:, :3, :3] = np.eye(3)
    return replace(found, world_to_camera=poses)


def near_is_left(geometry):
    return bool(geometry.inverse_depth[0, 0] > geometry.inverse_depth[0, -1])


def test_a_camera_that_need_not_turn_is_likelier(carried):
    turning = replace(reversed_geometry(carried), other_order=OtherOrder.of(carried))
    for geometry in (carried, turning):
        taken = in_likelier_order(geometry)
        assert near_is_left(taken)
        assert taken.other_order is None
        assert taken.order_errors == 0.0
        np.testing.assert_allclose(taken.world_to_camera, carried.world_to_camera, atol=1e-6)


def test_what_tracks_found_the_other_way_round_is_taken_rather_than_a_mere_reflection(found):
    other = replace(reversed_geometry(found), reprojection_rms_px=0.77)
    taken = in_likelier_order(replace(found, order_errors=-3.0, other_order=OtherOrder.of(other)))
    assert not near_is_left(taken)
    assert taken.reprojection_rms_px == 0.77
    assert taken.order_errors == pytest.approx(1.0)


def test_an_error_of_tracks_overrules_a_camera_that_need_not_turn(carried):
    turning = reversed_geometry(carried)
    assert not near_is_left(in_likelier_order(replace(turning, order_errors=1.1)))
    taken = in_likelier_order(replace(turning, order_errors=0.9))
    assert near_is_left(taken)
    assert taken.order_errors == 0.0


def test_only_an_estimated_path_whose_tracks_are_not_sure_is_open(found):
    sure = Criteria().order_errors
    assert is_open(found, Criteria())
    assert is_open(replace(found, order_errors=sure - 0.1), Criteria())
    assert not is_open(replace(found, order_errors=sure), Criteria())
    assert not is_open(replace(found, verdict="static"), Criteria())
    assert not is_open(replace(found, order_given=True, order_errors=-9.0), Criteria())
    assert not is_open(replace(found, source="file"), Criteria())


@pytest.mark.parametrize(
    ("order", "code"),
    [
        (OrderFound(0.4), Code.DEPTH_ORDER_OPEN),
        (OrderFound(), None),
    ],
)
def test_what_is_known_of_an_order_is_said_only_of_a_path(found, order, code):
    assert [note.code for note in order_findings(order, found)] == ([code] if code else [])
    assert order_findings(order, replace(found, verdict="static")) == ()
