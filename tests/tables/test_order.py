import numpy as np
import pytest

from gs2ci.core.errors import InputError
from tests.tables.order import depth_rank, inside_out


def slope():
    return 1 + np.linspace(0, 1, 48).reshape(6, 8)


def test_depths_in_the_right_order_rank_alike_whatever_their_scale():
    assert depth_rank(7 * slope() ** 3, slope()) == pytest.approx(1)


def test_depths_inside_out_rank_the_other_way():
    assert depth_rank(3 - slope(), slope()) == pytest.approx(-1)


def test_unknown_depths_do_not_count():
    found, true = slope(), slope()
    found[0], true[1, :4], found[2, 0] = 0, np.nan, np.inf
    assert depth_rank(found, true) == pytest.approx(1)


@pytest.mark.parametrize("found", [np.full((6, 8), 2.0), np.zeros((6, 8))])
def test_one_depth_or_none_has_no_order(found):
    assert depth_rank(found, slope()) is None
    assert depth_rank(slope(), found) is None


def test_depths_of_another_shape_are_refused():
    with pytest.raises(InputError, match="cannot be compared"):
        depth_rank(slope(), slope().T)


def test_either_figure_tells_that_a_scene_is_inside_out():
    assert inside_out(0.3, 0.9) == inside_out(None, None) == ""
    assert "backwards" in inside_out(178.0, None)
    assert "rank correlation of depth -0.76" in inside_out(0.3, -0.76)
    assert " and " in inside_out(178.0, -0.76)
