"""Features of views, and which of two views' match."""

import numpy as np
import pytest

from gs2ci.reconstruct.geometry.tracks import features
from gs2ci.reconstruct.geometry.tracks.features import find_features, match_features
from tests.reconstruct.geometry.orbits import PLACES, around


@pytest.fixture(scope="module")
def scene(seen):
    return seen(poses=around(PLACES, 1.0), size=(135, 180), focal=150.0)


def test_only_the_strongest_features_of_tilted_pictures_are_kept(scene):
    all_places, _ = find_features(scene.views[2], 100_000)
    places, descriptors = find_features(scene.views[2], 100)
    assert (len(places), len(descriptors)) == (100, 100)
    assert len(all_places) > 1000
    assert {tuple(place) for place in places} <= {tuple(place) for place in all_places}


def test_matches_are_mutual_distinct_and_one_to_one():
    one = np.eye(4, dtype=np.float32)
    one[1] = one[0]
    other = one[[0, 2, 2]]
    # The last two of `other` are alike: the third of `one` has no distinct match, and its fourth has none at all.
    np.testing.assert_array_equal(match_features(one, other), [[0, 0]])
    # The first two of `one` are alike; of two that match its third, the first does.
    np.testing.assert_array_equal(match_features(other, one), [[1, 2]])
    assert match_features(one[:1], other).shape == (0, 2)


def test_matches_are_the_same_in_parts(monkeypatch, scene):
    (_, one), (_, other) = (find_features(view) for view in scene.views[:2])
    whole = match_features(one, other)
    assert len(whole) > 30
    monkeypatch.setattr(features, "_ROWS", 7)
    np.testing.assert_array_equal(match_features(one, other), whole)


def test_a_plain_view_has_no_features():
    places, descriptors = find_features(np.full((24, 32, 3), 0.5, np.float32))
    assert (places.shape, descriptors.shape) == ((0, 2), (0, 128))
