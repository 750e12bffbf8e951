import importlib
import inspect
import re
from dataclasses import asdict

import pytest

from gs2ci import cli
from gs2ci.api.overrides import Overrides
from gs2ci.core.findings import Code, finding
from gs2ci.evaluate.pages import next_steps as module
from gs2ci.evaluate.pages.next_steps import RULES, next_steps, outcome
from gs2ci.reconstruct.presets.named import preset
from tests.evaluate.reports import GOOD, a_report

DIVERGED = finding(Code.FIT_DIVERGED, times=4, best=50)
UNIFORM = finding(Code.UNIFORM_MOTION, share=0.5)
LOOK = GOOD["curve"][0]


def looks(heldout):
    return [{**LOOK, "iteration": 50 * i, "heldout": value} for i, value in enumerate(heldout)]


def improving(*more):
    curve = [*looks(0.1 - 0.005 * i for i in range(11)), *more]
    return a_report(curve=curve, stopped=finding(Code.FIT_ALL_DONE, iterations=500, best=450))


CASES = {
    "fit_failed": a_report(stopped=DIVERGED),
    "stage_knows_the_path": a_report(geometry__verdict="unsupported", geometry__asked_for="tracks"),
    "camera_did_not_translate": a_report(geometry__verdict="rotation_only"),
    "too_little_to_track": a_report(geometry__verdict="unsupported", geometry__tracks=7),
    "scene_lost": a_report(verdict="decode"),
    "nobody_judged": a_report(finding(Code.UNJUDGED)),
    "too_bright": a_report(finding(Code.SATURATED, share=0.2), measured__saturated_share=0.2),
    "still_improving": improving(),
    "focal_was_assumed": a_report(geometry__focal_source="default"),
    "loose_tracks": a_report(geometry__reprojection_rms_px=4.0),
    "uncertain_path": a_report(
        finding(Code.PATH_UNCERTAIN, share=0.123), geometry__path_error_expected=0.123, geometry__tracks=98
    ),
    "little_parallax": a_report(geometry__parallax_px=1.2),
    "closed_pixels": a_report(measured__closed_share=0.3),
    "simulation_was_coarse": a_report(simulation__error_dn=3.0),
    "average_more": a_report(ensemble={"fits": 2, "averaged": 2, "spread": 0.0123}),
    "look_at_it": a_report(),
}


def test_every_rule_has_a_case():
    assert [rule.__name__ for rule in RULES] == list(CASES)


@pytest.mark.parametrize("name", CASES)
def test_a_rule_speaks_in_its_case_and_is_silent_on_a_good_run(name):
    rule = getattr(module, name)
    step = rule(CASES[name])
    assert step is not None
    assert step.what
    assert step.because.endswith(".")
    if name != "look_at_it":
        assert rule(a_report()) is None


@pytest.mark.parametrize("name", CASES)
def test_a_rule_that_finds_no_evidence_is_silent(name):
    nobody = {"refined": None, "scene": None, "decode": None}
    bare = a_report(geometry=None, ensemble=None, simulation=None, curve=[], residual__heldout_rms=nobody)
    assert getattr(module, name)(bare) is None


def test_what_is_told_is_read_from_the_report():
    assert "20.0%" in module.too_bright(CASES["too_bright"]).because
    assert "30%" in module.closed_pixels(CASES["closed_pixels"]).because
    assert "by 1.2 px rms, and their own scatter is 1.1 px" in module.little_parallax(CASES["little_parallax"]).because
    assert "4 px" in module.loose_tracks(CASES["loose_tracks"]).because
    assert "98 points" in module.uncertain_path(CASES["uncertain_path"]).because
    assert "error of the first path is 12%" in module.uncertain_path(CASES["uncertain_path"]).because
    assert "--iterations 1000" in module.still_improving(CASES["still_improving"]).command
    assert "(0.05 against 0.021)" in module.scene_lost(CASES["scene_lost"]).because
    assert "come from 2" in module.average_more(CASES["average_more"]).because
    assert "0.012 of a view" in module.average_more(CASES["average_more"]).because
    assert "290 px" in module.focal_was_assumed(a_report(geometry__focal_source="estimated")).because


def test_a_path_is_doubted_where_its_run_doubted_it():
    assert module.uncertain_path(a_report(geometry__path_error_expected=0.5)) is None
    untracked = module.uncertain_path(a_report(UNIFORM, geometry__path_error_expected=None))
    assert "Too few points could be tracked" in untracked.because


def test_commands_are_ours():
    for case in CASES.values():
        for step in next_steps(case, most=99):
            if step.command:
                program, command = step.command.split()[:2]
                assert program == "gs2ci"
                assert command in cli.COMMANDS


def test_options_in_commands_exist():
    for case in CASES.values():
        for step in next_steps(case, most=99):
            if step.command:
                run = importlib.import_module(cli.COMMANDS[step.command.split()[1]][0]).run
                for option in re.findall(r"--([a-z-]+)", step.command):
                    assert option.replace("-", "_") in inspect.signature(run).parameters, step.command


def test_only_so_many_are_told_the_most_telling_first():
    bad = a_report(
        finding(Code.SATURATED, share=0.2),
        stopped=DIVERGED,
        geometry__verdict="unsupported",
        measured__saturated_share=0.2,
        measured__closed_share=0.2,
        geometry__focal_source="default",
    )
    steps = next_steps(bad)
    assert len(steps) == module.MOST_STEPS
    assert steps[0] == module.fit_failed(bad)


def test_a_fit_that_stopped_by_itself_is_not_told_to_run_longer():
    stalled = improving().model_copy(update={"stopped": finding(Code.FIT_STALLED, best=450)})
    assert module.still_improving(stalled) is None
    assert module.still_improving(improving().model_copy(update={"curve": a_report().curve})) is None


def test_the_page_and_the_run_agree_on_what_is_worth_saying():
    """A page is written without what fits, so its numbers cannot be read from there."""
    assert preset("fine").fits == module.FEW_FITS
    for name, iterations in module.ITERATIONS.items():
        assert preset(name).fit.iterations == iterations
        assert (preset(name).stride_px == module.FINE_STRIDE_PX) == (name == "fine")


@pytest.mark.parametrize(
    ("name", "iterations", "advised"),
    [
        ("draft", None, ""),
        ("draft", 50, ""),
        ("draft", 600, " --iterations 1200"),
        ("standard", 399, ""),
        ("standard", None, " --iterations 800"),
        ("fine", 400, " --preset fine"),
        ("fine", None, " --preset fine --iterations 1200"),
    ],
)
def test_more_iterations_are_more_than_the_presets_own(name, iterations, advised):
    iterations = iterations or preset(name).fit.iterations
    curve = [{**LOOK, "iteration": iterations * i // 10, "heldout": 0.1 - 0.005 * i} for i in range(11)]
    settings = asdict(Overrides(iterations=iterations).on(preset(name)))
    report = a_report(curve=curve, stopped=finding(Code.FIT_ALL_DONE, iterations=iterations, best=1), settings=settings)
    step = module.still_improving(report)
    assert step.command == f"gs2ci reconstruct SHOT.h5 -o NEW_RUN{advised}"
    words = step.command.split()
    options = {key[2:]: value for key, value in zip(words[5::2], words[6::2], strict=True)}
    better = Overrides(iterations=int(options["iterations"]) if "iterations" in options else None)
    assert better.on(preset(options.get("preset", "standard"))).fit.iterations > iterations


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
        (a_report(finding(Code.PATH_UNCERTAIN, share=0.1)), "With doubts", "mixed"),
        (a_report(UNIFORM), "With doubts", "mixed"),
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
