import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci_sims.moments import Moments, gauss_nodes, gauss_weights, lagrange, one_per_interval
from gs2ci_sims.signals import nominal_slices

INTERVALS = np.array([[0.0, 1.0], [1.0, 2.0], [2.0, 3.0]])


def test_views_stand_for_the_whole_of_every_slice():
    slices = nominal_slices(INTERVALS).split(7)
    weights = Moments(np.array([0.0, 0.4, 1.7, 3.0]), 4).weights_s(slices)
    np.testing.assert_allclose(weights.sum(axis=0), slices.duration_s, rtol=1e-12)


@pytest.mark.parametrize("nodes", [1, 2, 3, 6])
def test_polynomials_of_lower_degree_than_there_are_nodes_are_integrated_exactly_behind_any_mask(nodes):
    moments = Moments(np.array([0.0, 1.3, 3.0]), nodes)
    slices = nominal_slices(INTERVALS).split(3)
    light = np.polynomial.Polynomial(np.arange(1.0, nodes + 1))
    exact = light.integ()(slices.stop_s) - light.integ()(slices.start_s)
    np.testing.assert_allclose(light(moments.times_s) @ moments.weights_s(slices), exact, rtol=1e-10)


def test_whole_panels_are_integrated_to_twice_that_degree():
    moments = Moments(np.array([0.0, 1.0, 2.0, 3.0]), 3)
    light = np.polynomial.Polynomial([1.0, -2.0, 0.5, 3.0, -1.0, 0.2])
    exact = light.integ()(INTERVALS[:, 1]) - light.integ()(INTERVALS[:, 0])
    np.testing.assert_allclose(light(moments.times_s) @ moments.weights_s(nominal_slices(INTERVALS)), exact)


def test_one_view_per_interval_is_its_middle_with_gaps_and_without():
    for gap in (0.0, 0.25):
        intervals = INTERVALS + gap * np.arange(3)[:, None]
        moments = one_per_interval(intervals)
        np.testing.assert_allclose(moments.times_s, intervals.mean(axis=1))
        np.testing.assert_allclose(moments.weights_s(nominal_slices(intervals)), np.eye(3), atol=1e-12)


def test_times_outside_belong_to_the_nearest_panel():
    moments = Moments(np.array([0.0, 1.0, 3.0]), 1)
    assert moments._panel(np.array([-5.0, 9.0])).tolist() == [0, 1]


def test_gauss_weights_add_up_and_lagranges_polynomials_are_one_at_their_nodes():
    for count in (1, 2, 5, 12):
        assert gauss_weights(count).sum() == pytest.approx(1.0)
        np.testing.assert_allclose(lagrange(gauss_nodes(count), gauss_nodes(count)), np.eye(count), atol=1e-9)


@pytest.mark.parametrize(("edges", "nodes"), [([0.0, 1.0], 0), ([0.0], 1), ([0.0, 0.0], 1), ([1.0, 0.0], 1)])
def test_panels_without_length_or_views_are_refused(edges, nodes):
    with pytest.raises(InputError, match="panels of time"):
        Moments(np.array(edges), nodes)


def test_basis_polynomials_are_one_at_their_node_and_reproduce_polynomials():
    for count in (1, 2, 7, 32):
        nodes = gauss_nodes(count)
        np.testing.assert_array_equal(lagrange(nodes, nodes), np.eye(count))
        places = np.linspace(-0.02, 1.02, 57)
        power = min(count - 1, 6)
        np.testing.assert_allclose(lagrange(nodes, places) @ nodes**power, places**power, atol=1e-10)
