"""Corners followed between exposures: along the right similarity, along a wrong one, and where nothing is seen."""

import numpy as np
import pytest

from gs2ci.reconstruct.exposures.corners import Matches, followed, matched
from gs2ci.reconstruct.exposures.pictures import pictures_of
from gs2ci.reconstruct.exposures.similarity import Similarity
from tests.reconstruct.exposures.rooms import PLACES, UNITS, exposure, middle, truly


@pytest.fixture(scope="module")
def two(four):
    return [pictures_of(one.views, one.geometry) for one in four[:2]]


def test_most_corners_are_found_along_the_right_similarity_where_they_belong(two):
    other_from_one = truly(PLACES, UNITS)[1].inverse
    found, visible = followed(*two, other_from_one)
    assert len(found) > 0.7 * visible
    off = np.linalg.norm(other_from_one.points(found.one) - found.other, axis=1)
    assert np.median(off) < 0.01
    assert len(np.unique(found.corners)) == len(found)


def test_few_are_found_along_a_wrong_one(two):
    wrong = truly(PLACES, UNITS)[1].inverse.changed(np.array([0, 0.1, 0.1, 0.1, 0, 0, 0]), np.array([0, 0, 1.0]), 1.0)
    found, visible = followed(*two, wrong)
    assert visible > 100
    assert len(found) < 0.1 * visible


def test_none_are_found_in_a_plain_picture_or_behind_the_camera(two):
    plain = exposure("plain", middle())
    nothing = pictures_of(np.full_like(plain.views, 0.5), plain.geometry)
    assert len(followed(two[0], nothing, Similarity.identity())[0]) == 0
    behind = Similarity(1.0, np.diag([-1.0, 1.0, -1.0]), np.zeros(3))
    found, visible = followed(*two, behind)
    assert (len(found), visible) == (0, 0)


def test_features_of_two_exposures_are_matched_and_swapped(two):
    found = matched(*two)
    assert len(found) > 20
    assert set(found.corners) == {-1}
    np.testing.assert_array_equal(found.swapped.one, found.other)
    np.testing.assert_array_equal(found.swapped.pictures, found.pictures[:, ::-1])
    assert len(found.keep(np.arange(len(found)) < 5)) == 5


def test_no_matches_join_to_none():
    assert len(Matches.joined(())) == 0
    assert Matches.joined(()).one.shape == (0, 3)
