import copy
import importlib
import inspect
import re
from dataclasses import asdict

import pytest

from gs2ci import cli
from gs2ci.evaluate.pages import next_steps as module
from gs2ci.evaluate.pages.next_steps import RULES, next_steps, outcome
from gs2ci.reconstruct.measurement.doubts import SATURATION_WORTH_SAYING
from gs2ci.reconstruct.presets import preset
from gs2ci.reconstruct.settings import Settings

GOOD = {
    "verdict": "refined",
    "views": 8,
    "gaussians": 13000,
    "stopped_because": "held-out pixels stopped improving at iteration 500",
    "geometry": {
        "method": "tracks",
        "verdict": "full",
        "tracks": 800,
        "reprojection_rms_px": 1.1,
        "parallax_px": 3.0,
        "path_error_expected": 0.01,
        "focal_px": 290.0,
        "focal_source": "file",
    },
    "residual": {"heldout_rms": {"refined": 0.02, "scene": 0.021, "decode": 0.05}},
    "measured": {"closed_share": 0.01, "saturated_share": 0.0, "telemetry": True},
    "curve": [{"iteration": 50 * i, "heldout": 0.1 - 0.01 * i + 0.002 * max(0, i - 5) ** 2} for i in range(11)],
    "provenance": {"plan": {"error_dn": 0.8, "tolerance_dn": 1.0}},
    "ensemble": {"fits": 4, "averaged": 4, "spread": 0.01},
    "settings": asdict(Settings()),
}


def report(**changes):
    """A good report with changes; a key a__b changes what lies in a."""
    found = copy.deepcopy(GOOD)
    for key, value in changes.items():
        *path, last = key.split("__")
        at = found
        for part in path:
            at = at[part]
        at[last] = value
    return found


def improving():
    curve = [{"iteration": 50 * i, "heldout": 0.1 - 0.005 * i} for i in range(11)]
    return report(curve=curve, stopped_because="all 500 iterations done, held-out pixels best at iteration 500")


CASES = {
    "fit_failed": report(stopped_because="numbers ran away 4 times; kept the state of iteration 50"),
    "stage_knows_the_path": report(geometry__verdict="unsupported", geometry__asked_for="tracks"),
    "camera_did_not_translate": report(geometry__verdict="rotation_only"),
    "too_little_to_track": report(geometry__verdict="unsupported", geometry__tracks=7),
    "scene_lost": report(verdict="decode"),
    "nobody_judged": report(residual__heldout_rms={"refined": None, "scene": None, "decode": None}),
    "too_bright": report(measured__saturated_share=0.2),
    "still_improving": improving(),
    "focal_was_assumed": report(geometry__focal_source="default"),
    "loose_tracks": report(geometry__reprojection_rms_px=4.0),
    "uncertain_path": report(geometry__path_error_expected=0.123, geometry__tracks=98),
    "little_parallax": report(geometry__parallax_px=1.2),
    "closed_pixels": report(measured__closed_share=0.3),
    "simulation_was_coarse": report(provenance__plan={"error_dn": 3.0, "tolerance_dn": 1.0}),
    "average_more": report(ensemble={"fits": 2, "averaged": 2, "spread": 0.0123}),
    "look_at_it": report(),
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
        assert rule(GOOD) is None


@pytest.mark.parametrize("name", CASES)
def test_a_rule_that_finds_no_evidence_is_silent(name):
    bare = {"verdict": "refined", "views": 8, "gaussians": 1, "stopped_because": "", "residual": {}, "curve": []}
    assert getattr(module, name)(bare) is None


def test_what_is_told_is_read_from_the_report():
    assert "20.0%" in module.too_bright(CASES["too_bright"]).because
    assert "30%" in module.closed_pixels(CASES["closed_pixels"]).because
    assert "by 1.2 px rms, and they scatter by 1.1 px" in module.little_parallax(CASES["little_parallax"]).because
    assert "4 px" in module.loose_tracks(CASES["loose_tracks"]).because
    assert "98 tracked points" in module.uncertain_path(CASES["uncertain_path"]).because
    assert "err by 12%" in module.uncertain_path(CASES["uncertain_path"]).because
    assert "--iterations 1000" in module.still_improving(CASES["still_improving"]).command
    assert "(0.05 against 0.021)" in module.scene_lost(CASES["scene_lost"]).because
    assert "come from 2" in module.average_more(CASES["average_more"]).because
    assert "0.012 of a view" in module.average_more(CASES["average_more"]).because
    assert "290 px" in module.focal_was_assumed(report(geometry__focal_source="estimated")).because


def test_a_path_is_doubted_from_where_its_run_doubted_it():
    most = 0.07
    doubted = {"settings__geometry__criteria__path_error": most}
    assert module.uncertain_path(report(geometry__path_error_expected=most, **doubted)) is None
    assert module.uncertain_path(report(geometry__path_error_expected=most + 0.001, **doubted)) is not None
    assert module.uncertain_path(report(geometry__path_error_expected=None)) is None
    assert module.uncertain_path(report(geometry__path_error_expected=0.5, settings={})) is None
    untracked = module.uncertain_path(report(geometry__path_error_expected=None, geometry__method="uniform"))
    assert "Too few points could be followed" in untracked.because


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
    bad = report(
        stopped_because="numbers ran away 4 times; kept the state of iteration 50",
        geometry__verdict="unsupported",
        measured__saturated_share=0.2,
        measured__closed_share=0.2,
        geometry__focal_source="default",
    )
    steps = next_steps(bad)
    assert len(steps) == module.MOST_STEPS
    assert steps[0] == module.fit_failed(bad)


def test_a_fit_that_stopped_by_itself_is_not_told_to_run_longer():
    assert module.still_improving(report(curve=CASES["still_improving"]["curve"])) is None
    assert module.still_improving({**improving(), "curve": GOOD["curve"]}) is None


def test_the_page_and_the_run_agree_on_what_is_worth_saying():
    """A page is written without what fits, so its numbers cannot be read from there."""
    assert preset("fine").fits == module.FEW_FITS
    assert module.SATURATED_SHARE == SATURATION_WORTH_SAYING


def test_the_mean_at_the_end_of_the_curve_is_no_look_of_the_fit():
    mean = {"iteration": 500, "heldout": 0.01}
    stopped = {**improving(), "curve": [*GOOD["curve"], mean]}
    assert module.still_improving(stopped) is None
    assert (
        "--iterations 1000" in module.still_improving({**improving(), "curve": [*improving()["curve"], mean]}).command
    )


@pytest.mark.parametrize(
    ("changes", "word", "tone"),
    [
        ({}, "Recovered", "good"),
        ({"geometry__verdict": "static"}, "Views, no depth", "mixed"),
        ({"geometry__verdict": "rotation_only"}, "Views, no depth", "mixed"),
        ({"geometry__verdict": "unsupported"}, "Views, no depth", "mixed"),
        ({"stopped_because": "numbers ran away 4 times; kept the state of iteration 50"}, "With doubts", "mixed"),
        ({"geometry__path_error_expected": 0.1}, "With doubts", "mixed"),
        ({"geometry__method": "uniform", "geometry__path_error_expected": None}, "With doubts", "mixed"),
        ({"verdict": "decode"}, "Views only", "poor"),
    ],
)
def test_the_outcome_is_named_and_what_is_missing_is_in_the_headline(changes, word, tone):
    found = outcome(report(**changes))
    assert (found.word, found.tone) == (word, tone)
    assert found.headline.startswith("8 views")
    assert ("3D" in found.headline) == (word == "Recovered")


def test_one_view_is_one():
    assert outcome(report(views=1)).headline.startswith("1 view,")
