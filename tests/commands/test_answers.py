"""Commands that a program calls: answers as JSON alone on standard output, silence, colours, exit statuses."""

import importlib
import json
import webbrowser
from pathlib import Path

import pytest

from gs2ci.cli import COMMANDS
from gs2ci.commands import calibrate
from gs2ci.commands import compile as compiling
from gs2ci.commands.completion import options_of
from gs2ci.rig.updating import Update
from gs2ci_calibration.estimates import Estimate
from tests.api.conftest import examples, filled
from tests.evaluate.conftest import make_run, scene

pytestmark = pytest.mark.usefixtures("undrawn")

__all__ = ["examples", "filled", "make_run", "scene"]


ANSWERS = [
    ("reconstruct shot.h5 -o mine --preset draft --iterations 2", {"folder": "mine", "views": 4}),
    ("decode shot.h5 -o decoded --iterations 3", {"folder": "decoded", "schema": "gs2ci.decode/1"}),
    ("evaluate run shot.h5", {"schema": "gs2ci.evaluation/2", "novel_views": None}),
    ("measure run 8,12 24,12", {"unit": "scene units", "view": 3}),
    ("plan rig.toml --tolerance-dn 2", {"tolerance_dn": 2.0}),
    ("devices --rig rig.toml", {"sensor": None, "modulator": None, "stage": None}),
    ("capture --rig rig.toml -o taken.h5", {"file": "taken.h5", "shots": 1}),
    ("import measurement.npz -o imported.h5", {"file": "imported.h5", "shots": 1, "guesses": None}),
    ("export run --to nexus", {"path": "run.nxs", "format": "nexus"}),
    ("mesh run --voxels 32", {"path": "mesh.ply"}),
    ("capture --rig rig.toml --dry-run", {"file": None, "shots": 0}),
]
QUIET = [(command, holds) for command, holds in ANSWERS if not command.startswith("reconstruct")]  # it takes a while


@pytest.mark.parametrize(
    ("command", "holds", "silence"), [(*case, ()) for case in ANSWERS] + [(*case, ("--quiet",)) for case in QUIET]
)
def test_an_answer_is_json_and_stands_alone(command, holds, silence, examples, gs2ci, capsys):
    assert gs2ci(*command.split(), "--json", *silence) == 0
    told = capsys.readouterr()
    answer = json.loads(told.out)
    for key, value in holds.items():
        assert key in answer
        assert value is None or answer[key] == value
    assert bool(told.err) is not bool(silence)


def test_lists_are_answered_as_lists(examples, gs2ci, capsys):
    assert gs2ci("models", "list", "--json") == 0
    assert json.loads(capsys.readouterr().out) == []
    assert gs2ci("doctor", "--rig", "rig.toml", "--no-trigger-loop", "--json") == 0
    findings = json.loads(capsys.readouterr().out)
    assert {finding["verdict"] for finding in findings} <= {"ok", "note", "know"}
    assert {"what", "detail", "remedy"} <= set(findings[0])
    assert gs2ci("plugins", "--json") == 0
    assert isinstance(json.loads(capsys.readouterr().out), list)
    assert gs2ci("devices", "--json") == 0
    assert isinstance(json.loads(capsys.readouterr().out), list)


def test_a_calibration_is_answered_by_its_estimates(examples, gs2ci, capsys):
    words = ("--rig", "rig.toml", "-o", "b.cal.h5", "--json")
    assert gs2ci("calibrate", "dark-flat", *words) == 0
    answer = json.loads(capsys.readouterr().out)
    (section,) = answer["sections"]
    assert (answer["bundle"], section["name"]) == ("b.cal.h5", "dark-flat")
    kinds = {frozenset(estimate) for estimate in section["estimates"].values()}
    assert {"value", "standard_error", "unit"} in kinds
    assert kinds <= {
        frozenset({"value", "standard_error", "unit"}),
        frozenset({"median", "rms_error", "unit", "shape"}),
    }
    assert gs2ci("calibrate", "check", *words) == 0
    changes = json.loads(capsys.readouterr().out)["changes"]
    assert changes
    assert not any(change["too_far"] for change in changes)
    with (examples / "rig.toml").open("a") as rig:
        rig.write("[world.sensor]\nblack_level_dn = 80.0\n")
    assert gs2ci("calibrate", "check", *words) == 2
    told = capsys.readouterr()
    assert any(change["too_far"] for change in json.loads(told.out)["changes"])
    assert "changed by more than allowed" in told.err


def test_an_update_is_answered_by_its_parameters(gs2ci, capsys, monkeypatch):
    moved = Update({"down_px": Estimate(0.5, 0.01, "px")}, ("down_px",), 0.5, 1, (), Path("old.h5"))
    monkeypatch.setattr(calibrate, "update_bundle", lambda *_: moved)
    assert gs2ci("calibrate", "update", "b.cal.h5", "shot.h5", "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["parameters"] == {"down_px": {"value": 0.5, "standard_error": 0.01, "unit": "px"}}
    assert (answer["bundle"], answer["kept"], answer["taken"]) == ("b.cal.h5", "old.h5", ["down_px"])


def test_what_is_short_is_answered_too(examples, gs2ci, capsys, monkeypatch):
    assert gs2ci("report", "run", "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer == {"page": "run/report.html", "bytes": (examples / "run" / "report.html").stat().st_size}
    monkeypatch.setattr(compiling, "compile_kernels", lambda: 2.5)
    assert gs2ci("compile", "--json") == 0
    assert json.loads(capsys.readouterr().out) == {"seconds": 2.5}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_an_answer_but_those_that_only_show(command):
    options = {name for one in options_of(importlib.import_module(COMMANDS[command][0]).run) for name in one.names}
    assert ("--json" in options) is (command not in {"open", "view", "live", "completion"})


def test_a_quiet_command_says_nothing_but_why_it_failed(examples, gs2ci, capsys):
    assert gs2ci("--quiet", "decode", "shot.h5", "--iterations", 2) == 0
    assert capsys.readouterr() == ("", "")
    assert gs2ci("decode", "no.h5", "--quiet") == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert "no.h5" in told.err
    assert gs2ci("plan", "rig.toml") == 0
    assert "tolerance" in capsys.readouterr().out
    assert gs2ci("--quiet", "--version") == 0
    assert capsys.readouterr().out.startswith("gs2ci ")


@pytest.mark.parametrize(("variable", "coloured"), [("FORCE_COLOR", True), ("NO_COLOR", False)])
def test_colours_are_left_out_where_nobody_wants_them(variable, coloured, examples, gs2ci, capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv(variable, "1")
    assert gs2ci("decode", "no.h5") == 2
    assert ("\x1b[1;31m" in capsys.readouterr().err) is coloured


def test_the_page_of_a_run_is_opened(examples, gs2ci, capsys, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or True)
    assert gs2ci("open", "run") == 0
    (examples / "run" / "report.html").unlink()
    assert gs2ci("open", "run/") == 0
    assert opened == 2 * [(examples / "run" / "report.html").as_uri()]
    monkeypatch.setattr(webbrowser, "open", lambda address: False)
    capsys.readouterr()
    assert gs2ci("open", "run") == 0
    assert "no browser was found" in capsys.readouterr().out
    for wrong in ("nowhere", "."):
        assert gs2ci("open", wrong) == 2
    assert "report.json" in capsys.readouterr().err


def test_a_folder_of_runs_opens_with_its_index(examples, gs2ci, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or True)
    (examples / "index.html").write_text("<!doctype html>")
    assert gs2ci("open", ".") == 0
    assert opened == [(examples / "index.html").resolve().as_uri()]
