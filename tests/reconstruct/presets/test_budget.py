"""Which fits are chosen within a budget, and that a fit ends in time although nothing was known of its pace."""

import itertools
import math
from dataclasses import replace

import numba
import numpy as np
import pytest

from gs2ci.core.findings import DOUBT, Code
from gs2ci.core.records import Shot
from gs2ci.reconstruct.fit.coarse.pace import Timed, slower_beside
from gs2ci.reconstruct.pipeline import reconstruct
from gs2ci.reconstruct.presets.budget import KEPT_BACK, LADDER, Budget
from gs2ci.reconstruct.presets.named import PRESETS

STANDARD = PRESETS["standard"]


@pytest.fixture(autouse=True)
def threads(request, monkeypatch):
    """Two threads, or as many as a test asks for: which fits are chosen depends on them, not on the machine's own."""
    count = getattr(request, "param", 2)
    monkeypatch.setattr(numba, "get_num_threads", lambda: count)
    return count


def timed(iteration_s=0.05, look_s=0.2, moments_per_mask=1.0):
    found = Timed(4, moments_per_mask)
    found._moments_s = [0.0, *(7.0 + iteration_s * np.arange(4))]  # the first one took 7 s
    found._processor_s = list(found._moments_s)
    found.looked(look_s)
    return found


def chosen(seconds, spent_s=5.0, adapt=lambda settings: settings):
    return Budget(seconds, 500.0 - spent_s, adapt, clock=lambda: 500.0).fit(STANDARD, timed())


def test_iterations_with_one_moment_per_mask_cost_less_than_the_timed_ones():
    within = Budget(60.0, 495.0, clock=lambda: 500.0)
    plain, split = (within.fit(STANDARD, timed(moments_per_mask=moments))[1] for moments in (1.0, 4.0))
    assert [split._costs(share) / plain._costs(share) for share in (0.0, 0.49, 0.5, 1.0)] == pytest.approx(
        [0.25, 0.25, 1, 1]
    )


def rung_of(settings):
    return next(rung for rung in LADDER if PRESETS[rung.preset].fits == settings.fits)


def test_the_first_iteration_is_not_counted():
    assert timed(0.05).iteration_s == pytest.approx(0.05)


def test_a_processor_that_others_use_too_makes_the_report_wait():
    busy = timed()
    busy._processor_s = [moment_s / 4 for moment_s in busy._moments_s]
    assert busy.waiting == pytest.approx(4)
    alone = timed()
    alone._processor_s = [2 * moment_s for moment_s in alone._moments_s]
    assert alone.waiting == 1
    within = Budget(60.0, 495.0, clock=lambda: 500.0)
    assert within.fit(STANDARD, busy)[0].fit.iterations < within.fit(STANDARD, alone)[0].fit.iterations


@pytest.mark.parametrize("threads", [1, 2, 3, 4, 16], indirect=True)
def test_more_time_never_buys_cheaper_fits_or_fewer_iterations_of_the_same():
    order = [PRESETS[rung.preset].fits for rung in reversed(LADDER)]
    found = [chosen(seconds)[0] for seconds in (12, 20, 30, 60, 120, 240, 500, 2000)]
    ranks = [order.index(one.fits) for one in found]
    assert ranks == sorted(ranks)
    assert (ranks[0], ranks[-1]) == (0, len(order) - 1)
    for one, next_one in itertools.pairwise(found):
        if one.fits == next_one.fits:
            assert one.fit.iterations <= next_one.fit.iterations


@pytest.mark.parametrize("seconds", [20.0, 60.0, 300.0])
@pytest.mark.parametrize("threads", [1, 2, 8], indirect=True)
def test_the_fits_are_expected_to_take_what_is_left_and_no_more(seconds, threads):
    settings, pace, _ = chosen(seconds)
    dearer = math.sqrt(settings.fit.gaussians_per_pixel / STANDARD.fit.gaussians_per_pixel)
    fit_s = settings.fit.iterations * 0.05 * 1.5 * slower_beside(settings.fits, threads) * dearer
    left_s = (1 - KEPT_BACK) * seconds - 5.0
    rung = rung_of(settings)
    assert fit_s < left_s
    assert fit_s > 0.5 * left_s or settings.fit.iterations == rung.most
    assert rung.least <= settings.fit.iterations <= rung.most
    assert pace.total(0) == pytest.approx(settings.fit.iterations, rel=0.1)


@pytest.mark.parametrize("seconds", [30, 45, 60])
@pytest.mark.parametrize("threads", [1, 2, 3, 4, 16], indirect=True)
def test_seconds_that_are_spent_are_spent(seconds):
    late = chosen(seconds, spent_s=15.0)[0]
    less = chosen(seconds - 10.0 / (1 - KEPT_BACK), spent_s=5.0)[0]
    assert (late.fits, late.fit) == (less.fits, less.fit)
    early = chosen(seconds, spent_s=5.0)[0]
    assert (early.fits, early.fit) != (late.fits, late.fit)


def polished_in(seconds, polish_s, settings=STANDARD):
    return Budget(seconds, 495.0, clock=lambda: 500.0).fit(settings, timed(), 0.0, polish_s)


def test_polishing_gets_its_time_if_that_is_no_large_part_of_what_is_left():
    none, some, much = (polished_in(60.0, polish_s) for polish_s in (0.0, 10.0, 25.0))
    assert some[0].polish == STANDARD.polish
    assert 0 < some[0].fit.iterations < none[0].fit.iterations
    assert some[1]._until_s == pytest.approx(none[1]._until_s - 10.0)
    assert (much[0].polish, much[0].fit, much[1]._until_s) == (None, none[0].fit, none[1]._until_s)


def test_another_decode_is_part_of_what_comes_afterwards():
    within = Budget(60.0, 495.0, clock=lambda: 500.0)
    none, one = (within.fit(STANDARD, timed(), decode_s)[1] for decode_s in (0.0, 4.0))
    assert one._until_s == pytest.approx(none._until_s - 4.0)


def test_drafts_are_not_polished_within_a_budget_either_and_nothing_is_against_the_settings():
    draft = polished_in(20.0, 1.0)[0]
    assert rung_of(draft).preset == "draft"
    assert draft.polish is None
    assert polished_in(60.0, 0.0, replace(STANDARD, polish=None))[0].polish is None


def test_what_no_preset_decides_is_kept_and_what_is_done_is_not_said_to_be_otherwise():
    settings, _, _ = chosen(15, adapt=lambda settings: replace(settings.with_density_rule("mcmc"), fits=3))
    assert (settings.fits, settings.fit.density.name) == (3, "mcmc")
    assert (settings.decode, settings.geometry) == (STANDARD.decode, STANDARD.geometry)


def test_the_sentence_says_what_was_decided():
    settings, _, note = chosen(60)
    assert note.code is Code.TIME_DIVIDED
    assert note.sentence.startswith("Of 60 s, 5.0 s went to start, decode and geometry")
    assert f"about {settings.fit.iterations} iterations" in note.sentence


@pytest.mark.parametrize("seconds", [0.1, 6])
def test_too_little_time_leaves_a_fit_of_one_iteration_and_says_what_would_do(seconds):
    settings, pace, note = chosen(seconds)
    assert (settings.fit.iterations, pace.total(0), pace.total(1)) == (1, 1, 1)
    assert (note.code, note.code.weight) == (Code.TIME_TOO_SHORT, DOUBT)
    enough = note.figures["enough"]
    assert 6 < enough < 15
    assert chosen(enough)[2].code is Code.TIME_DIVIDED
    assert rung_of(chosen(enough)[0]).preset == "draft"


def test_a_machine_that_turns_out_a_hundred_times_slower_ends_in_time_all_the_same():
    """On a clock of its own, on which every iteration takes a second; the timed ones took some hundredths."""

    class Clock:
        now_s = 0.0

        def __call__(self):
            self.now_s += 1.0
            return self.now_s

    rng = np.random.default_rng(0)
    masks = (rng.random((3, 24, 32)) < 0.4).astype(np.float32)
    shot = Shot(rng.random((24, 32, 3), dtype=np.float32), masks, np.ones(3, np.float32)).check()

    def one_unjudged(settings):
        hold_out = replace(settings.fit.hold_out, share=0.0)
        return replace(settings, fits=1, fit=replace(settings.fit, hold_out=hold_out))

    clock = Clock()
    result = reconstruct(shot, one_unjudged(STANDARD), budget=Budget(120.0, 0.0, one_unjudged, clock)).result
    assert result.stopped.code is Code.FIT_TIME_UP_UNJUDGED
    assert 40 < result.curve[-1].iteration < 120
    assert clock.now_s <= 120.0
