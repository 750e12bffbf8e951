import pytest

from gs2ci.evaluate.tradeoff.front import agreement, measure_of, pareto, sentences


def row(trial, seconds, psnr_db=None, heldout_db=None):
    return {"trial": trial, "seconds": seconds, "psnr_db": psnr_db, "heldout_db": heldout_db}


LADDER = [
    row("decode", 1, 24.0, 20.0),
    row("draft", 20, 28.0, 24.0),
    row("standard", 60, 31.0, 26.5),
    row("fine", 180, 31.5, 27.0),
    row("wasteful", 100, 30.0, 26.0),
]


def test_the_front_is_what_no_other_beats_from_the_quickest():
    assert [one["trial"] for one in pareto(LADDER, "psnr_db")] == ["decode", "draft", "standard", "fine"]


def test_of_equal_seconds_or_equal_quality_one_is_on_the_front():
    rows = [row("a", 1, 20.0), row("b", 1, 21.0), row("c", 2, 21.0), row("unknown", 0.1)]
    assert [one["trial"] for one in pareto(rows, "psnr_db")] == ["b"]


def test_the_truth_counts_where_it_is_known_and_held_out_pixels_where_not():
    assert measure_of(LADDER) == "psnr_db"
    assert measure_of([row("a", 1, None, 20.0)]) == "heldout_db"
    assert measure_of([row("a", 1)]) is None
    assert "only times" in sentences([row("a", 1)])[0]


def test_the_words_give_each_step_its_price_and_the_next_decibel_its():
    said = sentences(LADDER)
    assert said[0] == "Decode: 24.00 dB in 1.0 s, the quickest of all."
    assert said[1] == "Draft: 4.00 dB more than decode for 19 s more, 4.8 s for each decibel (28.00 dB in 20 s)."
    assert said[4] == (
        "The next decibel after standard costs 4 min 00 s at the rate of fine, which gives 0.50 dB for 2 min 00 s; "
        "no trial gains a whole decibel, the largest gain is 0.50 dB."
    )


def test_a_step_of_nearly_nothing_gets_no_price():
    assert "each decibel" not in sentences([row("a", 1, 20.0), row("b", 9, 20.01)])[1]


def test_where_nothing_beats_the_standard_the_words_say_so():
    said = sentences(LADDER[:3])
    assert said[3] == "No trial is noticeably better than standard, 31.00 dB."


def test_where_something_quicker_beats_the_standard_the_words_say_so():
    said = sentences([*LADDER[:3], row("lucky", 30, 31.2)])
    assert "The standard is not worth its time here: lucky gives 0.20 dB more in 30 s less." in said


def test_the_cheapest_way_to_more_is_named_not_the_nearest():
    said = sentences([*LADDER[:3], row("slow", 160, 31.5), row("rich", 200, 33.0)])
    assert any("costs 70 s at the rate of rich, which gives 2.00 dB for 2 min 20 s." in one for one in said)


def test_agreement_is_one_where_both_order_alike_and_counts_what_a_wrong_choice_loses():
    found = agreement(LADDER)
    assert found.tau == pytest.approx(1)
    assert (found.regret_db, found.trials) == (0, 5)
    misled = agreement([row("a", 1, 30.0, 20.0), row("b", 2, 29.0, 25.0), row("c", 3, 28.0, 22.0)])
    assert misled.tau < 0
    assert misled.regret_db == 1.0


def test_too_few_trials_or_all_alike_tell_nothing_of_agreement():
    assert agreement(LADDER[:2]) is None
    alike = agreement([row(str(k), k, 30.0, 20.0) for k in range(4)])
    assert alike.tau is None
    assert not any("Kendall" in one for one in sentences([row(str(k), k + 1, 30.0, 20.0) for k in range(4)]))


def test_without_a_truth_the_words_say_what_the_decibels_are():
    said = sentences([row("a", 1, None, 20.0), row("standard", 2, None, 23.0)])
    assert said[-1].startswith("The truth is not known")
