"""Regimes along a figure of the rig: where a bound passes the limit."""

import math

import numpy as np
import pytest

from gs2ci_sims.sweeping import FigureSweep, along, picture

VALUES = np.array([0.1, 1.0, 10.0])


def sweep_of(values=VALUES, **bounds):
    bounds = {name: np.array(bound) for name, bound in bounds.items()}
    return FigureSweep("x", "part.x", "s", values, 1.0, bounds, np.full(len(values), 0.1), (1, 2, 3))


def test_a_bound_that_grows_as_a_power_of_the_figure_matters_from_where_it_meets_the_limit():
    one = sweep_of(square=0.3 * VALUES**2, falls=0.05 / VALUES)
    ((begins, ends),) = one.regimes("square")
    assert begins == pytest.approx((0.1 / 0.3) ** 0.5)
    assert ends == math.inf
    ((begins, ends),) = one.regimes("falls")
    assert begins == -math.inf
    assert ends == pytest.approx(0.5)


def test_an_effect_matters_where_its_bound_is_above_the_limit():
    one = sweep_of(just_below=[0.099] * 3, just_above=[0.101] * 3)
    assert not one.matters("just_below").any()
    assert one.matters("just_above").all()


def test_an_effect_may_matter_everywhere_nowhere_or_in_between():
    one = sweep_of(everywhere=[1, np.inf, 1], nowhere=[0, 0, 0.1], between=[0.01, 1, 0.01])
    assert one.regimes("everywhere") == ((-math.inf, math.inf),)
    assert one.regimes("nowhere") == ()
    ((begins, ends),) = one.regimes("between")
    assert 0.1 < begins < 1 < ends < 10
    assert begins * ends == pytest.approx(1)


def test_figures_that_pass_through_zero_are_interpolated_evenly():
    one = sweep_of(np.array([-1.0, 0.0, 1.0]), rises=[0.01, 0.1, 1])
    assert one.regimes("rises")[0][0] == pytest.approx(0.0, abs=1e-12)


def test_wide_ranges_are_cut_in_equal_ratios_and_narrow_ones_evenly():
    assert np.allclose(along(0.1, 10, 3), [0.1, 1, 10])
    assert np.allclose(along(1, 3, 3), [1, 2, 3])
    assert np.allclose(along(-1, 10, 3), [-1, 4.5, 10])


def test_the_record_leaves_out_ends_that_were_not_reached():
    record = sweep_of(square=0.3 * VALUES**2, never=[np.inf] * 3).record()
    assert record["effects"]["square"]["matters"] == [[pytest.approx(0.577, abs=1e-3), None]]
    assert record["effects"]["never"]["bounds_dn"] == [None, None, None]


def test_the_map_is_a_picture_with_a_panel_per_figure():
    one = sweep_of(square=0.3 * VALUES**2, nothing=[0, 0, 0], never=[np.inf] * 3)
    assert picture([one]).startswith(b"\x89PNG")
    assert len(picture([one, one])) > len(picture([one]))
