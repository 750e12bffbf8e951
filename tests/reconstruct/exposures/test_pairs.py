"""Pairs of exposures: tied by features or from a guess, with errors that are those made; and not tied at all."""

import numpy as np
import pytest

from gs2ci.reconstruct.exposures.pairs import projected, tie_pair
from gs2ci.reconstruct.exposures.pictures import pictures_of
from tests.reconstruct.exposures.rooms import PLACES, UNITS, exposure, middle, truly


@pytest.fixture(scope="module")
def two(four):
    return [pictures_of(one.views, one.geometry) for one in four[:2]]


def test_features_tie_two_exposures_within_the_stated_errors(two):
    pair = tie_pair(*two)
    change = pair.other_from_one.change_to(truly(PLACES, UNITS)[1].inverse, pair.centre, pair.unit)
    deviations = np.sqrt(np.diag(pair.covariance))
    assert np.abs(change).max() < 0.01
    assert (np.abs(change) < 4 * deviations).all()
    assert pair.share > 0.7
    assert pair.unit == pytest.approx(1.2, abs=0.9)
    assert len(pair.matches) > 200


def test_a_rough_guess_is_enough(two):
    true = truly(PLACES, UNITS)[1].inverse
    guess = true.changed(np.array([0.01, -0.01, 0.01, 0.01, 0.01, 0, 0.1]), np.array([0, 0, 1.0]), 1.0)
    pair = tie_pair(*two, guess)
    assert np.abs(pair.other_from_one.change_to(true, pair.centre, pair.unit)).max() < 0.01


def test_a_wrong_guess_and_another_scene_tie_nothing(two):
    wrong = truly(PLACES, UNITS)[1].inverse.changed(np.array([0, 0.5, 0.3, 0.1, 0, 0, 0]), np.array([0, 0, 1.0]), 1.0)
    assert tie_pair(*two, wrong) is None
    elsewhere = exposure("elsewhere", middle(), seed=9, noise=0.02)
    assert tie_pair(two[0], pictures_of(elsewhere.views, elsewhere.geometry)) is None


def test_a_wrong_depth_of_one_of_them_hardly_matters(four, two):
    plane = exposure("plane", PLACES[1], unit=UNITS[1], noise=0.02)
    plane.geometry.inverse_depth[:] = np.median(plane.geometry.inverse_depth)
    pair = tie_pair(two[0], pictures_of(plane.views, plane.geometry))
    change = pair.other_from_one.change_to(truly(PLACES, UNITS)[1].inverse, pair.centre, pair.unit)
    assert np.abs(change[:5]).max() < 0.02


def test_points_behind_the_camera_are_placed_far_out():
    poses, matrix = np.eye(4)[None], np.diag([100.0, 100.0, 1.0])[None]
    places, depth = projected(np.array([[1.0, 0.0, -2.0]]), poses, matrix)
    assert np.isfinite(places).all()
    assert places[0, 0] > 5000
    assert depth[0] > 0
