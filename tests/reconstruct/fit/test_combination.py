"""Convex combinations of views, judged by pixels that none of them saw."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.reconstruct.fit.combination import combined, shares
from gs2ci.reconstruct.measurement.jury import Jury


@pytest.fixture
def jury(smooth_shot):
    return Jury.of(smooth_shot, 0.3, 0)


def noisy(views, seed, deviation=0.1):
    return (views + np.random.default_rng(seed).normal(0, deviation, views.shape)).astype(np.float32)


def test_the_right_one_stands_alone(jury):
    truth = jury.shot.truth.views
    found = shares(jury, {"right": truth, "wrong": noisy(truth, 1), "dark": 0 * truth})
    assert found == {"right": pytest.approx(1), "wrong": 0.0, "dark": 0.0}


def test_a_combination_that_made_the_measurement_is_found(jury):
    truth = jury.shot.truth.views
    step = noisy(truth, 2) - truth
    candidates = {"over": truth + step, "under": truth - step / 3}
    found = shares(jury, candidates)
    assert found == {"over": pytest.approx(0.25, abs=0.01), "under": pytest.approx(0.75, abs=0.01)}
    assert np.allclose(combined(candidates, found), truth, atol=0.01)


def test_two_that_err_alike_and_apart_are_better_together(jury):
    truth = jury.shot.truth.views
    candidates = {"one": noisy(truth, 3), "other": noisy(truth, 4)}
    found = shares(jury, candidates)
    errors = {name: np.mean((views - truth) ** 2) for name, views in candidates.items()}
    assert np.mean((combined(candidates, found) - truth) ** 2) < 0.75 * min(errors.values())
    assert sum(found.values()) == pytest.approx(1)


@pytest.mark.parametrize("what", ["nothing held out", "dark", "not finite"])
def test_the_first_stands_where_nothing_tells(jury, what):
    truth = jury.shot.truth.views
    candidates = {"first": truth, "second": noisy(truth, 5)}
    if what == "nothing held out":
        jury = Jury(jury.shot, np.zeros(jury.shot.size, bool))
    elif what == "dark":
        jury = Jury(replace(jury.shot, measurement=0 * jury.shot.measurement), jury.heldout)
    else:
        candidates["second"] = np.full_like(truth, np.nan)
    assert shares(jury, candidates) == {"first": 1.0, "second": 0.0}


def test_what_has_no_share_need_not_be_there(jury):
    truth = jury.shot.truth.views
    assert np.array_equal(combined({"first": truth}, {"first": 1.0, "second": 0.0}), truth)
