"""When a fit of the other order of depth is made, and which of the two is taken; the fits are replaced."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from gs2ci.core.errors import NumericsError
from gs2ci.core.findings import Code, finding
from gs2ci.core.halt import Halt
from gs2ci.core.progress import Silent
from gs2ci.reconstruct.attempts.attempt import Attempt, How
from gs2ci.reconstruct.attempts.both_orders import in_shown_order
from gs2ci.reconstruct.first_look import FirstLook
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.occlusion import Occlusion

UNTRACKED = finding(Code.UNIFORM_MOTION, share=0.9)
OPEN = finding(Code.DEPTH_ORDER_OPEN, errors=0.5)


@dataclass(frozen=True)
class Fit:
    """A fit; whether near is left in it, and whether its views only count in the mean."""

    near_left: bool
    beside: bool = False

    @property
    def views(self):
        """Get what stands for its views: its order."""
        return self.near_left


class Fits:
    """Makes fits that hide as much as they are told to in each block, near left and near right."""

    def __init__(self, near_left, near_right, *, blocks=16, is_open=True, fails=False, more=1.0):
        self.blocks, self.more = blocks, more
        self.hides, self.is_open, self.fails = {True: near_left, False: near_right}, is_open, fails
        self.halt, self.progress, self.made = Halt(), Silent(), []
        self.halt.begin()

    def is_order_open(self, _geometry):
        return self.is_open

    def attempt(self, look, views, how):
        assert views is look.decoded
        self.made.append(how)
        if self.fails:
            raise NumericsError("numbers ran away", remedy="none")
        return attempt_at(look)

    def refine(self, views):
        return views

    def occlusion(self, tried, views):
        assert views == tried.fits[0].near_left
        return Occlusion(np.full((self.blocks, 1), self.hides[tried.fits[0].near_left]), 10.0)

    @property
    def holdout(self):
        return SimpleNamespace(residual_rms=lambda near_left: 0.1 if near_left else 0.1 * self.more)

    def completed(self, tried, beside=()):
        return replace(tried, fits=(*tried.fits, *beside), later=())


def attempt_at(look):
    depth = look.geometry.inverse_depth
    return Attempt(look, look.geometry, (Fit(bool(depth[0, 0] > depth[0, -1])),), None, ("companion",))


@pytest.fixture
def tried():
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, 0, 3] = (-0.2, -0.1, 0, 0.1)
    depth = np.tile(np.linspace(1.3, 0.7, 16, dtype=np.float32), (12, 1))
    notes, camera = (UNTRACKED, OPEN), np.diag([200.0, 200, 1])
    geometry = Geometry(poses, camera, "file", depth, 2, 9, 0.0, 2.0, "full", notes, order_errors=0.5)
    return attempt_at(FirstLook(None, np.zeros((4, 12, 16, 1), np.float32), geometry, None))


def codes(attempt):
    return [note.code for note in attempt.geometry.notes]


def test_the_order_in_which_near_things_hide_far_ones_in_the_views_too_is_kept_and_said(tried):
    fits = Fits(0.3, 0.1)
    taken = in_shown_order(fits, tried)
    assert taken.look is tried.look
    assert codes(taken) == [Code.UNIFORM_MOTION, Code.DEPTH_ORDER_SHOWN]
    assert "3.0 times" in taken.geometry.notes[-1].sentence
    assert taken.geometry.order_errors == pytest.approx(4.0)
    assert fits.made == [How(alone=True)]


def test_the_other_order_is_taken_if_it_is_the_one_that_views_show(tried):
    taken = in_shown_order(Fits(-0.1, 0.3), tried)
    assert not taken.fits[0].near_left
    assert taken.geometry.inverse_depth[0, 0] < taken.geometry.inverse_depth[0, -1]
    np.testing.assert_allclose(taken.geometry.world_to_camera[:, 0, 3], (0.2, 0.1, 0, -0.1))
    assert codes(taken) == [Code.UNIFORM_MOTION, Code.DEPTH_ORDER_SHOWN]
    assert "99.0 times" in taken.geometry.notes[-1].sentence


@pytest.mark.parametrize(("near_left", "near_right"), [(0.3, 0.1), (0.1, 0.3)])
def test_a_few_blocks_leave_the_order_open(tried, near_left, near_right):
    taken = in_shown_order(Fits(near_left, near_right, blocks=2), tried)
    assert taken.look is tried.look
    assert codes(taken) == [Code.UNIFORM_MOTION, Code.DEPTH_ORDER_OPEN]
    assert taken.geometry.order_errors == 0.5


@pytest.mark.parametrize(("near_left", "near_right"), [(0.2, 0.15), (0.15, 0.2), (0.0, 0.0), (1e-6, 0.0)])
def test_an_order_that_occlusion_does_not_tell_stays_open(tried, near_left, near_right):
    taken = in_shown_order(Fits(near_left, near_right), tried)
    assert taken.look is tried.look
    assert codes(taken) == [Code.UNIFORM_MOTION, Code.DEPTH_ORDER_OPEN]
    assert taken.geometry.order_errors == 0.5


@pytest.mark.parametrize("near_right", [0.1, 0.9, 0.3])
def test_the_fit_of_the_order_that_is_not_taken_counts_in_the_mean_alone(tried, near_right):
    leader, companion = in_shown_order(Fits(0.3, near_right), tried).fits
    assert not leader.beside
    assert companion.beside
    assert leader.near_left != companion.near_left


@pytest.mark.parametrize(("more", "code"), [(1.2, Code.DEPTH_ORDER_SHOWN), (1.3, Code.DEPTH_ORDER_OPEN)])
def test_fits_that_differ_by_more_than_their_order_tell_nothing_of_it(tried, more, code):
    assert codes(in_shown_order(Fits(0.3, 0.0, more=more), tried))[-1] == code
    assert codes(in_shown_order(Fits(0.3, 0.0, more=1 / more), tried))[-1] == code


def test_an_order_that_is_not_open_has_one_fit(tried):
    fits = Fits(0.0, 9.0, is_open=False)
    assert in_shown_order(fits, tried) == replace(tried, later=())
    assert fits.made == []


def test_a_fit_of_the_other_order_that_fails_leaves_all_as_it_was(tried):
    taken = in_shown_order(Fits(0.0, 9.0, fails=True), tried)
    assert taken == replace(tried, later=())


def test_no_fit_of_the_other_order_is_begun_or_used_after_an_end_was_asked_for(tried, monkeypatch):
    fits = Fits(0.0, 9.0)
    whole = fits.attempt

    def interrupted(*given):
        assert fits.halt.ask()
        return whole(*given)

    monkeypatch.setattr(fits, "attempt", interrupted)
    for _ in range(2):
        assert in_shown_order(fits, tried) == replace(tried, later=())
    assert len(fits.made) == 1
