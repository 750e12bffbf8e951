"""A uniform motion against rest, by what brief fits leave; the fits are replaced."""

import numpy as np
import pytest

from gs2ci.core.findings import Code, finding
from gs2ci.core.progress import Silent
from gs2ci.reconstruct.attempts import moving_or_at_rest
from gs2ci.reconstruct.geometry.initialise import PLANE_NOTE, Geometry


@pytest.fixture
def uniform():
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, 0, 3] = (-0.2, -0.1, 0, 0.1)
    depth = np.tile(np.linspace(1.3, 0.7, 16, dtype=np.float32), (12, 1))
    notes = (finding(Code.UNIFORM_MOTION, share=0.9),)
    return Geometry(poses, np.diag([200.0, 200, 1]), "file", depth, 2, 0, 0.0, 0.0, "full", notes, source="uniform")


def fits(moving, rest):
    return lambda geometry, number: (moving if geometry.verdict == "full" else rest)[number]


def test_a_motion_that_leaves_less_stays_and_says_by_how_much(uniform):
    taken = moving_or_at_rest(uniform, fits((0.01, 0.01), (0.04, 0.04)), Silent())
    assert taken.verdict == "full"
    assert [note.code for note in taken.notes] == [Code.UNIFORM_MOTION, Code.ATTEMPTS_RANKED]
    assert "0.1000 of the measurement along a uniform motion and 0.2000 from rest" in taken.notes[1].sentence
    assert np.array_equal(taken.world_to_camera, uniform.world_to_camera)


def test_rest_is_taken_where_it_leaves_less_in_the_mean(uniform):
    taken = moving_or_at_rest(uniform, fits((0.01, 0.07), (0.03, 0.03)), Silent())
    assert taken.verdict == "unsupported"
    assert [note.code for note in taken.notes] == [Code.ATTEMPTS_RANKED, PLANE_NOTE.code]
    assert np.array_equal(taken.world_to_camera, np.tile(np.eye(4), (4, 1, 1)))
    assert (taken.inverse_depth == 1).all()


def test_fits_that_are_not_finite_lose(uniform):
    assert moving_or_at_rest(uniform, fits((np.inf, 0.1), (0.2, 0.2)), Silent()).verdict == "unsupported"
