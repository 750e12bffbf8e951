"""What follows from what whole fits of both orders hide, in the views of either."""

import numpy as np
import pytest

from gs2ci.reconstruct.geometry.depth.occlusion import Occlusion
from gs2ci.reconstruct.hypotheses.hypothesis import DepthOrder
from gs2ci.reconstruct.hypotheses.turned import explain_alike, shown_by

NONE = Occlusion(np.zeros((6, 8)), 100.0)
THINGS = np.where(np.arange(8) % 3 < 2, 0.02, 0.0) * np.ones((6, 1))
CLEAR = Occlusion(THINGS, 100.0)
FEWER = Occlusion(np.where(np.arange(6)[:, None] < 2, THINGS, 0.0), 100.0)
ONE_THING = Occlusion(np.where(np.arange(8) < 2, THINGS, 0.0), 100.0)


def test_an_order_is_shown_if_the_views_of_either_fit_show_it():
    first, order = shown_by([CLEAR, CLEAR], [NONE, NONE])
    assert first
    assert order.state == DepthOrder.SHOWN
    first, order = shown_by([NONE, NONE], [CLEAR, CLEAR])
    assert not first
    assert order.state == DepthOrder.SHOWN


def test_it_is_as_sure_as_the_views_that_show_it_least():
    order = shown_by([CLEAR, FEWER], [NONE, NONE])[1]
    assert order.state == DepthOrder.SHOWN
    assert order.errors == pytest.approx(12**0.5)
    assert order.times == 99.0


@pytest.mark.parametrize("theirs", [NONE, CLEAR])
def test_what_only_a_fits_own_views_show_of_it_is_likely(theirs):
    """Something floats before the second scene, in its own views alone; or in those of the first, the first does."""
    first, order = shown_by([theirs, NONE], [NONE, Occlusion(2.5 * CLEAR.evidence, 100.0)])
    assert not first
    assert order.state == DepthOrder.LIKELY
    assert order.errors == pytest.approx(36**0.5)


def test_nothing_is_told_where_neither_fit_shows_more_in_its_own_views():
    assert shown_by([CLEAR, NONE], [NONE, CLEAR]) is None
    assert shown_by([NONE, CLEAR], [CLEAR, NONE]) is None


def test_fits_that_leave_much_more_than_one_another_differ_by_more_than_their_order():
    assert explain_alike(1.0, 1.2)
    assert not explain_alike(1.3, 1.0)


def test_what_a_single_thing_says_is_likely():
    order = shown_by([ONE_THING, ONE_THING], [NONE, NONE])[1]
    assert order.state == DepthOrder.LIKELY
    assert shown_by([CLEAR, ONE_THING], [NONE, NONE])[1].state == DepthOrder.LIKELY


def test_what_moves_is_not_asked():
    moves = np.zeros((48, 64), bool)
    moves[:8, :8] = True
    assert shown_by([ONE_THING, ONE_THING], [NONE, NONE], moves) is None
    first, order = shown_by([CLEAR, CLEAR], [NONE, NONE], moves)
    assert first
    assert order.errors == pytest.approx(24**0.5)
    assert shown_by([CLEAR, CLEAR], [NONE, NONE], 0 * moves)[1].errors == pytest.approx(6.0)
