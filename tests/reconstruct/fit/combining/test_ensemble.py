import threading
import tracemalloc
from dataclasses import replace

import numba
import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError, NumericsError
from gs2ci.core.findings import Code, finding
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.reconstruct.fit.coarse.stage import CoarseFit
from gs2ci.reconstruct.fit.combining.ensemble import advance_together, combined, members
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.measurement.holdout import Holdout
from tests.patience import HANG_S

RULES = (Osgr.sparing(), Osgr.generous())


GOOD, BAD = finding(Code.UNJUDGED), finding(Code.ROLLED_BACK_NOT_FINITE, iteration=9, best=5)


class Listener(Silent):
    def __init__(self):
        super().__init__()
        self.stages = []

    def stage(self, name, total=None):
        self.stages.append(name)


def fit_of(views, scene=None, notes=()):
    poses, done = np.tile(np.eye(4), (len(views), 1, 1)), finding(Code.FIT_ALL_DONE, iterations=1, best=1)
    return CoarseFit(scene, poses, np.asarray(views, np.float32), (), done, notes, np.eye(3))


class Run:
    """A fit that is made at once."""

    def __init__(self, member, fit_one):
        self.member, self.fit_one, self.fit = member, fit_one, None

    def advance(self, share, progress):
        assert share == 1.0
        self.fit = self.fit_one(self.member, progress)


def together(fit_one, beginnings, listener):
    runs = [Run(member, fit_one) for member in beginnings]
    return [run.fit for run in advance_together(runs, 1.0, listener)]


def number(member, beginnings):
    return [each.seed for each in beginnings].index(member.seed)


def test_the_first_begins_as_it_is_and_the_others_within_a_gaussians_size_of_it(scattered):
    start = scattered(500)
    first, second, third, fourth = members(start, RULES, 4, seed=5)
    assert first.start is start
    assert first.seed == 5
    for member in (second, third, fourth):
        moved = (member.start.means - start.means) / start.log_scales.exp()
        assert float(moved.std()) == pytest.approx(0.5, rel=0.1)
        for name in ("log_scales", "quaternions", "opacity_logits", "colours"):
            assert torch.equal(member.start.parameters()[name], start.parameters()[name])
    assert not torch.equal(second.start.means, third.start.means)
    assert len({member.seed for member in (first, second, third, fourth)}) == 4


def test_density_rules_are_taken_in_turn(scattered):
    assert [member.density for member in members(scattered(3), RULES, 4, 0)] == [*RULES, *RULES]
    assert [member.density for member in members(scattered(3), RULES[:1], 2, 0)] == [RULES[0]] * 2


def test_the_same_seed_gives_the_same_beginnings_and_another_others(scattered):
    start = scattered(20)
    one, same, other = (members(start, RULES, 2, seed)[1] for seed in (1, 1, 2))
    assert torch.equal(one.start.means, same.start.means)
    assert one.seed == same.seed
    assert not torch.equal(one.start.means, other.start.means)


def test_beginnings_of_no_gaussians_are_empty(scattered):
    assert [len(member.start) for member in members(scattered(0), RULES, 3, 0)] == [0, 0, 0]


def test_fits_come_back_in_their_order_whichever_ends_first(scattered):
    beginnings = members(scattered(2), RULES, 3, 0)
    last_ended = threading.Event()

    def fit_one(member, progress):
        if member is beginnings[1]:
            assert last_ended.wait(HANG_S)
        if member is beginnings[2]:
            last_ended.set()
        return fit_of(np.full((1, 2, 2, 3), number(member, beginnings)))

    found = together(fit_one, beginnings, Listener())
    assert [float(fit.views[0, 0, 0, 0]) for fit in found] == [0.0, 1.0, 2.0]


def test_they_share_the_threads_and_give_them_back(scattered):
    before, seen = numba.get_num_threads(), {}
    beginnings = members(scattered(2), RULES, 2, 0)

    def fit_one(member, progress):
        seen[number(member, beginnings)] = numba.get_num_threads()
        return fit_of(np.zeros((1, 2, 2, 3)))

    together(fit_one, beginnings, Listener())
    assert seen[1] == max(1, before // 2)
    assert seen[0] + seen[1] == max(2, before)
    assert numba.get_num_threads() == before


def test_a_companion_whose_numbers_run_away_is_left_out_and_told(scattered):
    beginnings, listener = members(scattered(2), RULES, 3, 0), Listener()

    def fit_one(member, progress):
        if member is beginnings[1]:
            raise NumericsError("the first iteration of the fit is not finite")
        return fit_of(np.full((1, 2, 2, 3), number(member, beginnings)))

    found = together(fit_one, beginnings, listener)
    assert [float(fit.views[0, 0, 0, 0]) for fit in found] == [0.0, 2.0]
    assert listener.sentences == [
        "One of the further fits failed and is left out: the first iteration of the fit is not finite."
    ]


def test_an_error_of_the_leader_ends_its_companions(scattered):
    beginnings = members(scattered(2), RULES, 2, 0)
    iterations = []

    def fit_one(member, progress):
        if member is beginnings[0]:
            raise NumericsError("the leader ran away")
        while len(iterations) < 10**6:
            progress.step(len(iterations))
            iterations.append(1)
        return fit_of(np.zeros((1, 2, 2, 3)))

    with pytest.raises(NumericsError, match="the leader ran away"):
        together(fit_one, beginnings, Listener())
    assert len(iterations) < 10**6


def test_every_other_error_of_a_companion_is_raised(scattered):
    beginnings = members(scattered(2), RULES, 2, 0)

    def fit_one(member, progress):
        if member is beginnings[1]:
            raise InputError("a seed of -1")
        return fit_of(np.zeros((1, 2, 2, 3)))

    with pytest.raises(InputError, match="a seed of -1"):
        together(fit_one, beginnings, Listener())


@pytest.fixture
def judged(moving_plane):
    """A measurement whose true views are known, and its holdout."""
    shot, _ = moving_plane
    rng = np.random.default_rng(0)
    truth = rng.random((*shot.masks.shape, 3)).astype(np.float32)
    shot = replace(shot, measurement=np.einsum("nhw,nhwc->hwc", shot.masks, truth))
    return truth, Holdout.of(shot, 0.2, 0), rng


def alike(views):
    return views


def test_the_mean_of_fits_that_err_apart_is_nearer_the_truth(judged):
    truth, holdout, rng = judged
    fits = tuple(fit_of(truth + 0.1 * rng.standard_normal(truth.shape)) for _ in range(4))
    together = combined(fits, holdout, alike)
    assert together.averaged == 4
    assert np.abs(together.views - truth).std() < 0.06
    summary = together.summary()
    assert summary.spread == pytest.approx(0.1 * np.sqrt(3 / 4), rel=0.05)
    assert (summary.fits, summary.averaged) == (4, 4)
    np.testing.assert_allclose(together.views, np.mean([fit.views for fit in fits], axis=0), atol=1e-6)


def test_a_fit_that_is_surely_better_than_the_mean_stands_alone(judged):
    truth, holdout, _ = judged
    good, bad = fit_of(truth, notes=(GOOD,)), fit_of(truth + 0.5, notes=(BAD,))
    together = combined((bad, good), holdout, alike)
    assert together.best is good
    assert together.averaged == 1
    np.testing.assert_array_equal(together.views, good.views)
    assert together.notes[:2] == (GOOD, finding(Code.OF_ANOTHER_FIT, sentence=BAD.sentence, code=BAD.code))
    assert together.notes[2].code is Code.MEAN_REFUSED


def test_the_best_lends_its_scene_while_the_views_are_the_mean(judged):
    truth, holdout, rng = judged
    better = fit_of(truth + 0.10 * rng.standard_normal(truth.shape))
    worse = fit_of(truth + 0.11 * rng.standard_normal(truth.shape))
    together = combined((worse, better), holdout, alike)
    assert together.best is better
    assert together.others == (worse,)
    assert together.averaged == 2
    assert together.notes == ()


def test_a_single_fit_is_its_own_mean(judged):
    truth, holdout, _ = judged
    only = fit_of(truth)
    together = combined((only,), holdout, alike)
    assert (together.best, together.averaged, together.disagreement) == (only, 1, None)


def test_without_held_out_pixels_the_first_leads_and_the_mean_is_taken(judged):
    truth, holdout, _ = judged
    unjudged = Holdout(holdout.shot, np.zeros(holdout.shot.size, bool))
    first, second = fit_of(truth + 0.2), fit_of(truth)
    together = combined((first, second), unjudged, alike)
    assert together.best is first
    assert together.averaged == 2


def test_fits_that_agree_to_the_last_bit_have_no_spread(judged):
    truth, holdout, _ = judged
    together = combined((fit_of(truth), fit_of(truth)), holdout, alike)
    assert not together.disagreement.any()
    assert together.averaged == 2
    np.testing.assert_array_equal(together.views, truth)


def test_disagreement_shows_where_fits_differ(judged):
    truth, holdout, _ = judged
    other = truth.copy()
    other[:, 10:20, 10:20] += 0.2
    found = combined((fit_of(truth), fit_of(other)), holdout, alike).disagreement
    assert found.shape == truth.shape[:3]
    assert found[:, 14:16, 14:16] == pytest.approx(0.1, rel=1e-2)
    assert not found[:, 25:].any()


def test_the_mean_and_its_spread_take_little_more_memory_than_they_are():
    drawn = np.random.default_rng(0).random((2, 16, 48, 64, 3), dtype=np.float32)
    shot = Shot(np.ones((48, 64, 3), np.float32), np.ones((16, 48, 64), np.float32), np.ones(16, np.float32)).check()
    fits = tuple(fit_of(views) for views in drawn)
    tracemalloc.start()
    try:
        found = combined(fits, Holdout(shot, np.zeros((48, 64), bool)), lambda views: views)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    np.testing.assert_allclose(found.views, drawn.mean(axis=0), rtol=1e-6)
    apart = np.sqrt(np.mean((drawn[0] - drawn[1]) ** 2)) / 2
    assert np.sqrt(np.mean(found.disagreement**2)) == pytest.approx(apart, rel=0.02)
    assert peak < 2 * (found.views.nbytes + found.disagreement.nbytes)
