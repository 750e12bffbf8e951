"""Rest as a beginning, and the ranking of attempts."""

import numpy as np
import pytest

from gs2ci.core.findings import Code, finding
from gs2ci.reconstruct.attempts.choice import ranking
from gs2ci.reconstruct.first_look import FirstLook, from_rest, needs_rest
from gs2ci.reconstruct.geometry.initialise import PLANE_NOTE, Geometry


@pytest.fixture
def moving():
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, 0, 3] = (-0.2, -0.1, 0, 0.1)
    depth = np.tile(np.linspace(1.3, 0.7, 16, dtype=np.float32), (12, 1))
    notes = (finding(Code.UNIFORM_MOTION, share=0.9), finding(Code.DEPTH_ORDER_OPEN, errors=0.5))
    geometry = Geometry(poses, np.diag([200.0, 200, 1]), "file", depth, 2, 0, 0.0, 0.0, "full", notes, source="uniform")
    return FirstLook(None, None, geometry, None)


def test_rest_is_a_plane_before_a_still_camera_and_claims_no_path(moving):
    assert needs_rest(moving)
    rest = from_rest(moving).geometry
    assert (rest.verdict, rest.source, rest.notes) == ("unsupported", "tracks", (PLANE_NOTE,))
    assert np.array_equal(rest.world_to_camera, np.tile(np.eye(4), (4, 1, 1)))
    assert (rest.inverse_depth == 1).all()
    assert not needs_rest(from_rest(moving))


def test_the_ranking_names_every_attempt_and_the_margin():
    (said,) = ranking({"uniform motion": 0.0220, "rest": 0.0200, "second look": 0.0300, "lost": float("inf")})
    assert "rest 0.0200, uniform motion 0.0220, second look 0.0300" in said.sentence
    assert "10.0%" in said.sentence
    assert "lost" not in said.sentence


@pytest.mark.parametrize("left", [{"tracks": 0.1}, {"tracks": None, "rest": None}, {"tracks": 0.1, "rest": None}])
def test_one_attempt_alone_has_no_ranking(left):
    assert ranking(left) == ()
