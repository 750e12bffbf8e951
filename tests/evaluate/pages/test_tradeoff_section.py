import re
from dataclasses import replace

import pytest

from gs2ci.core.errors import StorageError
from gs2ci.evaluate.pages.run_page import write_run_page
from gs2ci.evaluate.pages.tradeoff_section import tradeoff_section
from gs2ci.evaluate.tradeoff.record import RECORD_NAME


def numbers(body):
    """The numbers of the front's points as they stand beside them, in the wide drawing and in the narrow one."""
    return [re.findall(r'class="name halo"[^>]*>(\d+)<', drawing) for drawing in body.split('class="narrow"')]


def test_it_says_draws_and_lists_every_trial(tradeoff_record):
    body = str(tradeoff_section(tradeoff_record).body)
    assert "Decode: 24.00 dB in 1 s, the quickest of all." in body
    assert numbers(body) == [["1", "2", "3"]] * 2
    assert "<title>4, 100 iterations: 70, 28</title>" in body
    assert "no other is both quicker and better" in body
    assert re.findall(r"<td><strong>([a-z ]+)</strong></td>", body) == ["decode", "draft", "standard"]
    assert ">100 iterations<" in body
    assert "gs2ci tradeoff shot.h5" in body
    assert "PSNR, dB" in body
    assert ">command<" in body
    assert ">command<" not in str(tradeoff_section(replace(tradeoff_record, command="")).body)


def test_the_front_is_a_staircase_through_its_trials(tradeoff_record):
    wide, _ = str(tradeoff_section(tradeoff_record).body).split('class="narrow"')
    corners = re.search(r'class="line muted" d="M([^"]*)"', wide)[1].split("L")
    places = [tuple(float(value) for value in corner.split(",")) for corner in corners]
    assert len(places) == 5  # three trials, and two corners between them
    for (x, y), (right, up) in zip(places[:-1:2], places[1::2], strict=True):
        assert (y, x < right) == (up, True)


def test_without_a_measure_there_is_no_chart_and_the_seconds_stay(tradeoff_record):
    trials = tuple(replace(trial, psnr_db=None, heldout_db=None, unbeaten=False) for trial in tradeoff_record.trials)
    body = str(tradeoff_section(replace(tradeoff_record, measure=None, trials=trials)).body)
    assert "<svg" not in body
    assert ">60.0<" in body
    unknown = str(tradeoff_section(replace(tradeoff_record, trials=trials)).body)
    assert "<svg" not in unknown


def test_where_everything_failed_only_the_words_are_left(tradeoff_record):
    said = ("decode failed: too small",)
    body = str(tradeoff_section(replace(tradeoff_record, trials=(), measure=None, sentences=said)).body)
    assert "too small" in body
    assert "<table" not in body


@pytest.mark.parametrize("unbeaten", [False, True])
def test_a_single_trial_is_a_single_point(tradeoff_record, unbeaten):
    alone = replace(tradeoff_record, trials=(replace(tradeoff_record.trials[0], unbeaten=unbeaten),))
    body = str(tradeoff_section(alone).body)
    assert body.count("<title>1, decode: 1, 24</title>") == 2
    assert numbers(body) == [["1"] * unbeaten] * 2


def test_hostile_names_stay_text(tradeoff_record):
    hostile = '<script>alert("x")</script>\u202e'
    trials = (replace(tradeoff_record.trials[0], trial=hostile, knob=hostile),)
    body = str(
        tradeoff_section(
            replace(
                tradeoff_record,
                sentences=(hostile,),
                trials=trials,
                command=hostile,
                machine=replace(tradeoff_record.machine, processor=hostile),
            )
        ).body
    )
    assert "<script" not in body
    assert "\u202e" not in body


def test_the_extremes_that_a_record_may_hold_are_drawn(tradeoff_record):
    trials = tuple(
        replace(tradeoff_record.trials[0], seconds=seconds, psnr_db=value)
        for seconds, value in ((1e-6, -1e12), (1e12, 1e12), (1.0, 0.0))
    )
    assert "<svg" in str(tradeoff_section(replace(tradeoff_record, trials=trials)).body)


def test_a_run_tells_what_accuracy_costs_only_where_that_is_known(own_run):
    knowing = write_run_page(own_run).read_text(encoding="utf-8")
    (own_run / RECORD_NAME).unlink()
    bare = write_run_page(own_run).read_text(encoding="utf-8")
    for mark in ("What accuracy costs", "tradeoff.json"):
        assert mark in knowing
        assert mark not in bare


def test_a_damaged_record_is_one_typed_error_and_the_earlier_page_stays(own_run):
    before = (own_run / "report.html").read_bytes()
    (own_run / RECORD_NAME).write_text("{")
    with pytest.raises(StorageError, match=r"tradeoff\.json cannot be read"):
        write_run_page(own_run)
    assert (own_run / "report.html").read_bytes() == before
