"""Places that a stage reports, against what exposures see."""

from dataclasses import replace

import numpy as np

from gs2ci.reconstruct.exposures.places import confirmed, disagreeing, displacements_px, elsewhere
from gs2ci.reconstruct.exposures.similarity import Similarity
from gs2ci.reconstruct.exposures.tie import Ties
from tests.reconstruct.exposures.rooms import PLACES, UNITS, exposure, truly

# In coordinates and a unit of the stage's own.
STAGE = Similarity(40.0, truly(PLACES, UNITS)[3].rotation, np.array([100.0, -30.0, 7.0]))


def reported():
    return {number: STAGE.after(one) for number, one in enumerate(truly(PLACES, UNITS))}


def test_a_stage_that_reports_the_truth_agrees(four_tied):
    off = displacements_px(four_tied, reported())
    assert list(off) == [0, 1, 2, 3]
    assert max(off.values()) < 0.5
    assert disagreeing(four_tied, reported()) == {}


def test_one_whose_place_is_wrong_is_named_and_no_other(four_tied):
    given = reported()
    given[2] = replace(given[2], translation=given[2].translation + np.array([10.0, 0, 0]))
    assert list(disagreeing(four_tied, given)) == [2]


def test_a_doubtful_tie_contradicts_nothing_that_its_errors_explain(four_tied):
    given = reported()
    given[2] = replace(given[2], translation=given[2].translation + np.array([10.0, 0, 0]))
    off_px = disagreeing(four_tied, given)[2]
    focal_px = four_tied.tied[2].geometry.intrinsics[0, 0]
    for errors, wrong in ((0.3, [2]), (0.7, [])):
        doubtful = tuple(replace(one, place_error=errors * off_px / focal_px) for one in four_tied.all)
        assert list(disagreeing(Ties(doubtful, None), given)) == wrong


def test_one_whose_place_lies_behind_the_others_is_infinitely_off(four_tied):
    given = reported()
    turned = Similarity(1.0, np.diag([-1.0, 1.0, -1.0]), np.zeros(3))
    given[1] = given[1].after(turned)
    assert disagreeing(four_tied, given)[1] == np.inf


def test_exposures_that_are_not_given_or_see_nothing_of_others_are_not_judged(four_tied):
    given = reported()
    del given[0]
    assert list(displacements_px(four_tied, given)) == [1, 2, 3]
    assert displacements_px(four_tied, {1: given[1]}) == {}
    assert displacements_px(Ties((), None), given) == {}


def test_places_that_neighbours_see_are_confirmed_and_a_wrong_one_is_not(four):
    assert confirmed(four, reported())
    given = reported()
    given[2] = replace(given[2], translation=given[2].translation + np.array([10.0, 0, 0]))
    assert not confirmed(four, given)


def test_what_sees_nothing_of_the_others_confirms_nothing(four):
    stray = exposure("stray", PLACES[0], seed=5, noise=0.02)
    assert not confirmed([four[0], stray], {0: Similarity.identity(), 1: Similarity.identity()})
    assert confirmed(four[:1], {0: Similarity.identity()})


def test_what_a_stage_puts_among_others_and_shows_nothing_of_theirs_is_elsewhere(four):
    stray = exposure("fifth", PLACES[1], seed=5, noise=0.02)
    given, agreed = {**reported(), 4: reported()[1]}, {0, 1, 2, 3}
    assert elsewhere([*four, stray], agreed, given) == [4]
    # Of the same room it may stay, however it missed being tied; so may what lies where no other looks.
    assert elsewhere([*four, four[1]], agreed, given) == []
    beside = replace(given[4], translation=given[4].translation + np.array([1e4, 0, 0]))
    assert elsewhere([*four, stray], agreed, {**given, 4: beside}) == []
    # Where none agrees with another, nobody tells which is elsewhere.
    assert elsewhere([*four, stray], set(), given) == []
