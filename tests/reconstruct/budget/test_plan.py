import itertools
from dataclasses import replace

import pytest

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.budget.costs import CostModel
from gs2ci.reconstruct.budget.plan import LADDER, affordable_iterations, plan_within
from gs2ci.reconstruct.presets import PRESETS

MODEL = CostModel(
    pixels=90_000, views=8, decode_step=0.01, geometry=1.0, plane=0.01, iteration=0.05, gaussian=1e-6, look=0.2
)


def plan(seconds, **more):
    return plan_within(seconds, MODEL, clock=lambda: 500.0, **more)


def test_more_time_never_buys_a_cheaper_preset_or_fewer_iterations_of_the_same():
    order = [rung.preset for rung in reversed(LADDER)]
    plans = [plan(seconds) for seconds in (8, 15, 30, 60, 120, 240, 500, 2000)]
    ranks = [order.index(one.preset) for one in plans]
    assert ranks == sorted(ranks)
    assert ranks[0] == 0
    assert ranks[-1] == len(order) - 1
    for one, next_one in itertools.pairwise(plans):
        if one.preset == next_one.preset:
            assert one.settings.fit.iterations <= next_one.settings.fit.iterations


@pytest.mark.parametrize("seconds", [10.0, 60.0, 300.0])
def test_what_is_planned_is_expected_to_take_the_time_there_is_and_no_more(seconds):
    one = plan(seconds, report_s=2.0, spent_s=1.0)
    expected = MODEL.predict(one.settings).total + 3.0
    assert expected <= seconds
    most = next(rung.most for rung in LADDER if rung.preset == one.preset)
    assert expected > 0.85 * seconds or one.settings.fit.iterations == most


def test_time_already_spent_and_the_report_are_taken_off():
    assert plan(60, spent_s=10, report_s=5).settings == plan(60, spent_s=0, report_s=15).settings
    assert plan(60, report_s=15).settings.fit.iterations < plan(60).settings.fit.iterations


def test_the_fit_may_stretch_to_all_that_its_preset_has_a_use_for_and_no_further():
    one = plan(60)
    most = next(rung.most for rung in LADDER if rung.preset == one.preset)
    assert one.settings.fit.iterations <= one.pace.total(0) <= most


def test_what_no_preset_decides_is_kept():
    one = plan(30, adapt=lambda settings: replace(settings, seed=7, poses="stage"))
    assert (one.settings.seed, one.settings.poses) == (7, "stage")
    assert one.settings.geometry == PRESETS[one.preset].geometry


def test_the_sentence_says_what_was_decided():
    sentence = plan(60, report_s=2.0).sentence
    assert sentence.startswith("Of 60 s, ")
    assert f"{plan(60, report_s=2.0).settings.fit.iterations} iterations" in sentence


def test_too_little_time_is_refused_with_what_would_do():
    with pytest.raises(InputError) as caught:
        plan(5, spent_s=1, report_s=1)
    enough = float(caught.value.allowed.split()[0])
    assert plan(enough, spent_s=1, report_s=1).preset == "draft"
    with pytest.raises(InputError):
        plan(enough - 1.1, spent_s=1, report_s=1)


def test_no_iteration_is_affordable_when_decode_and_geometry_take_all():
    assert affordable_iterations(MODEL, PRESETS["draft"], 1.0, 300) == 0
    assert affordable_iterations(MODEL, PRESETS["draft"], 1e9, 300) == 300
