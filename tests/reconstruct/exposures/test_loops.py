"""Loops of pairs: closed, and what contradicts them left out."""

import itertools

import numpy as np
from scipy.spatial.transform import Rotation

from gs2ci.reconstruct.exposures.corners import Matches
from gs2ci.reconstruct.exposures.loops import closed, group_of_most
from gs2ci.reconstruct.exposures.pairs import Pair
from gs2ci.reconstruct.exposures.similarity import CHANGES, Similarity

CENTRE = np.array([0.0, 0.0, 1.0])


def drawn(count, seed=0):
    """Draw common_from_own of exposures that see the same place, the first the identity."""
    rng = np.random.default_rng(seed)
    found = [Similarity.identity()]
    for _ in range(count - 1):
        turn = Rotation.from_rotvec(0.2 * rng.normal(size=3)).as_matrix()
        scale = float(rng.uniform(0.5, 2))
        found.append(Similarity(scale, turn, CENTRE - scale * turn @ CENTRE + 0.1 * rng.normal(size=3)))
    return found


def pair(one, other, change=None, corners=50):
    between = other.inverse.after(one)
    unit = 1 / other.scale
    if change is not None:
        between = between.changed(np.asarray(change, float), CENTRE, unit)
    points = np.tile(CENTRE, (corners, 1))
    nowhere = np.zeros((corners, 2))
    numbers = np.zeros(corners, np.int64)
    matches = Matches(points, between.points(points), nowhere, nowhere, np.zeros((corners, 2), np.int64), numbers)
    return Pair(between, CENTRE, unit, 1e-6 * np.eye(CHANGES), 0.5, matches)


def off(found, true):
    return np.abs(true.change_to(found, CENTRE, 1.0)).max()


def test_the_largest_group_is_taken_and_of_equal_ones_the_earliest():
    true = drawn(5)
    join = lambda *which: {(a, b): pair(true[a], true[b]) for a, b in which}  # noqa: E731
    assert group_of_most(join((0, 1), (2, 3), (3, 4)), 5) == [2, 3, 4]
    assert group_of_most(join((0, 4), (1, 3)), 5) == [0, 4]
    assert group_of_most({}, 3) == [0]


def test_a_chain_and_a_loop_give_the_coordinates_of_the_first():
    true = drawn(5)
    for which in ([(0, 1), (1, 2), (2, 3), (3, 4)], list(itertools.combinations(range(5), 2))):
        found = closed({(a, b): pair(true[a], true[b]) for a, b in which}, 5)
        assert sorted(found.similarities) == list(range(5))
        assert all(off(found.similarities[k], true[k]) < 1e-6 for k in range(5))
        assert (found.pairs, found.contradicting) == (tuple(which), ())


def test_a_loop_spreads_what_its_pairs_are_off():
    true = drawn(3)
    wrong = 0.03 * np.eye(CHANGES)[0]
    found = closed(
        {(0, 1): pair(true[0], true[1]), (1, 2): pair(true[1], true[2], wrong), (0, 2): pair(true[0], true[2])}, 3
    )
    assert found.contradicting == ()
    assert 0 < off(found.similarities[2], true[2]) < 0.02


def test_a_pair_that_contradicts_the_others_is_left_out_and_bends_nothing():
    true = drawn(5)
    pairs = {(a, b): pair(true[a], true[b]) for a, b in itertools.combinations(range(5), 2)}
    # It has the most corners, so that the tree begins with it.
    pairs[1, 3] = pair(true[1], true[3], [0.5, 0, 0, 0.4, 0, 0, 0.3], corners=200)
    found = closed(pairs, 5)
    assert found.contradicting == ((1, 3),)
    assert all(off(found.similarities[k], true[k]) < 1e-6 for k in range(5))


def test_without_pairs_the_first_is_alone():
    found = closed({}, 3)
    assert (list(found.similarities), found.pairs) == ([0], ())
