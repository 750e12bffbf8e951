"""What follows from what whole fits of both orders hide."""

import numpy as np
import pytest

from gs2ci.reconstruct.geometry.depth.occlusion import Occlusion
from gs2ci.reconstruct.hypotheses.hypothesis import DepthOrder
from gs2ci.reconstruct.hypotheses.turned import explain_alike, told_by

NONE = Occlusion(np.zeros((6, 8)), 100.0)
THINGS = np.where(np.arange(8) % 3 < 2, 0.02, 0.0) * np.ones((6, 1))
CLEAR = Occlusion(THINGS, 100.0)
ONE_THING = Occlusion(np.where(np.arange(8) < 2, THINGS, 0.0), 100.0)


def test_an_order_that_hides_what_the_views_do_not_show_is_likely_and_never_sure():
    first, order = told_by(CLEAR, NONE)
    assert first
    assert (order.state, order.times) == (DepthOrder.LIKELY, 99.0)
    assert order.errors == pytest.approx(36**0.5)
    first, order = told_by(NONE, CLEAR)
    assert not first
    assert order.state == DepthOrder.LIKELY


def test_nothing_is_told_where_neither_fit_shows_more():
    assert told_by(CLEAR, CLEAR) is None
    assert told_by(NONE, NONE) is None


def test_fits_that_leave_much_more_than_one_another_differ_by_more_than_their_order():
    assert explain_alike(1.0, 1.2)
    assert not explain_alike(1.3, 1.0)


def test_what_moves_is_not_asked():
    moves = np.zeros((48, 64), bool)
    moves[:8, :8] = True
    assert told_by(ONE_THING, NONE, moves) is None
    first, order = told_by(CLEAR, NONE, moves)
    assert first
    assert order.errors == pytest.approx(24**0.5)
    assert told_by(CLEAR, NONE, 0 * moves)[1].errors == pytest.approx(6.0)
