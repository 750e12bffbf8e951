import importlib
import inspect
import re

import pytest

from gs2ci import cli
from gs2ci.core.findings import Code, Weight, finding
from gs2ci.evaluate.pages import next_steps as module
from gs2ci.evaluate.pages.next_steps import next_steps, outcome
from tests.evaluate.reports import GOOD, a_report

DIVERGED = finding(Code.FIT_DIVERGED, times=4, best=50)
UNCERTAIN = finding(Code.PATH_UNCERTAIN, share=0.1)
LOOK = GOOD["curve"][0]


def looks(heldout):
    return [{**LOOK, "iteration": 50 * i, "heldout": value} for i, value in enumerate(heldout)]


def improving(*more):
    curve = [*looks(0.1 - 0.005 * i for i in range(11)), *more]
    return a_report(curve=curve, stopped=finding(Code.FIT_ALL_DONE, iterations=500, best=450))


@pytest.mark.parametrize("code", [code for code in Code if code.weight is not Weight.REMARK])
def test_every_doubt_and_failure_asks_for_its_remedy(code):
    figures = dict.fromkeys(code.figures, 2)
    report = a_report(finding(code, **figures))
    assert (next_steps(report)[0].what, next_steps(report)[0].because) == (code.remedy, report.notes[0].sentence)


def test_a_good_run_is_looked_at_and_a_remark_asks_for_nothing():
    remark = finding(Code.FIT_BEHIND, iterations=1, best=1)
    assert [step.command for step in next_steps(a_report(remark))] == ["gs2ci view RUN"]


def test_what_failed_comes_before_what_is_doubted_and_only_so_many_are_told():
    doubts = [UNCERTAIN, finding(Code.SATURATED, share=0.2), finding(Code.DEPTH_STARTS_AS_PLANE)]
    steps = next_steps(a_report(*doubts, finding(Code.UNJUDGED), stopped=DIVERGED))
    assert len(steps) == module.MOST_STEPS
    assert steps[0].what == Code.FIT_DIVERGED.remedy
    assert UNCERTAIN.sentence in [step.because for step in steps]


def of_exposure(name, note):
    figures = {**note.figures, "name": name, "sentence": note.sentence, "code": note.code}
    return finding(Code.OF_EXPOSURE, **figures)


@pytest.mark.parametrize("note", [UNCERTAIN, finding(Code.PATH_UNCONFIRMED, more=1.2)], ids=lambda note: note.code)
def test_a_doubt_of_one_exposure_is_one_of_the_joint_run_and_its_remedy_is_said_once(note):
    report = a_report(of_exposure("a-0", note), of_exposure("a-1", note))
    assert report.notes[0].kind is note.code
    assert report.notes[0].advice == f"In a-0: {note.sentence} {note.code.remedy}"
    assert outcome(report).word == "With doubts"
    steps = [step for step in next_steps(report) if step.what == note.code.remedy]
    assert [step.because for step in steps] == [f"In a-0: {note.sentence}"]


def test_a_simulation_beyond_its_tolerance_is_said():
    assert "3 DN rms; " in module.simulation_was_coarse(a_report(simulation__error_dn=3.0)).because
    assert module.simulation_was_coarse(a_report()) is None


def test_a_scene_without_depth_is_not_shown_around():
    for bad in ({"verdict": "decode"}, {"geometry__verdict": "static"}, {"geometry": None}):
        assert module.look_at_it(a_report(**bad)) is None


def test_commands_and_their_options_are_ours():
    written = [
        step.command for report in (improving(), a_report(simulation__error_dn=3.0)) for step in next_steps(report)
    ]
    written += re.findall(r"`(gs2ci [^`]*)`", "".join(code.remedy for code in Code))
    for command in filter(None, written):
        run = importlib.import_module(cli.COMMANDS[command.split()[1]][0]).run
        for option in re.findall(r"--([a-z-]+)", command):
            assert option.replace("-", "_") in inspect.signature(run).parameters, command


def test_a_fit_that_stopped_by_itself_is_not_told_to_run_longer():
    assert "--iterations 1000" in module.still_improving(improving()).command
    stalled = improving().model_copy(update={"stopped": finding(Code.FIT_STALLED, best=450)})
    assert module.still_improving(stalled) is None
    assert module.still_improving(improving().model_copy(update={"curve": a_report().curve})) is None
    assert module.still_improving(a_report(curve=[])) is None


def test_a_draft_is_followed_by_the_default_and_not_by_fewer_iterations_of_it():
    curve = [{**LOOK, "iteration": 60, "heldout": 0.03}, {**LOOK, "iteration": 120, "heldout": 0.02}]
    draft = a_report(curve=curve, stopped=finding(Code.FIT_ALL_DONE, iterations=120, best=120))
    assert module.still_improving(draft).command == "gs2ci reconstruct SHOT.h5 -o NEW_RUN"


def test_steps_of_a_joint_run_reconstruct_all_exposures_together():
    moved = None
    one = {"name": "a", "first_view": 0, "views": 4, "verdict": "scene", "heldout_rms": {}, "path": "stage"}
    exposures = [{**one, "heldout_rms": {"scene": 0.1, "decode": 0.2, "refined": 0.1}, "moved": moved}] * 4
    doubt = finding(Code.DEPTH_ORDER_OPEN, **dict.fromkeys(Code.DEPTH_ORDER_OPEN.figures, 2))
    joint = improving().model_copy(update={"exposures": a_report(exposures=exposures).exposures, "notes": [doubt]})
    steps = next_steps(joint)
    said = [step.command or step.what for step in steps if "gs2ci reconstruct" in step.command + step.what]
    assert len(said) == 2
    assert all("gs2ci reconstruct --together" in text for text in said)
    # 500 iterations of four exposures were asked for as 250 of one.
    assert "gs2ci reconstruct --together SHOTS.h5 -o NEW_RUN --iterations 500" in said


def test_the_mean_at_the_end_of_the_curve_is_no_look_of_the_fit():
    mean = {**LOOK, "iteration": 500, "heldout": 0.01}
    done = a_report(curve=[*GOOD["curve"], mean], stopped=finding(Code.FIT_ALL_DONE, iterations=500, best=300))
    assert module.still_improving(done) is None
    assert "--iterations 1000" in module.still_improving(improving(mean)).command


@pytest.mark.parametrize(
    ("report", "word", "tone"),
    [
        (a_report(), "Recovered", "good"),
        (a_report(geometry__verdict="static"), "Views, no depth", "mixed"),
        (a_report(geometry__verdict="rotation_only"), "Views, no depth", "mixed"),
        (a_report(geometry__verdict="unsupported"), "Views, no depth", "mixed"),
        (a_report(stopped=DIVERGED), "With doubts", "mixed"),
        (a_report(UNCERTAIN), "With doubts", "mixed"),
        (a_report(verdict="decode"), "Views only", "poor"),
    ],
)
def test_the_outcome_is_named_and_what_is_missing_is_in_the_headline(report, word, tone):
    found = outcome(report)
    assert (found.word, found.tone) == (word, tone)
    assert found.headline.startswith("8 views")
    assert ("3D" in found.headline) == (word == "Recovered")


def test_one_view_is_one():
    assert outcome(a_report().model_copy(update={"views": 1})).headline.startswith("1 view,")
