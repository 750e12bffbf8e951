"""Commands that a program calls: answers as JSON alone on standard output, silence, colours, exit statuses."""

import json
import webbrowser

import pytest

from tests.api.conftest import examples, filled
from tests.evaluate.conftest import make_run, scene

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
    assert {finding["verdict"] for finding in findings} <= {"ok", "note"}
    assert {"what", "detail", "remedy"} <= set(findings[0])
    assert gs2ci("plugins", "--json") == 0
    assert isinstance(json.loads(capsys.readouterr().out), list)
    assert gs2ci("devices", "--json") == 0
    assert isinstance(json.loads(capsys.readouterr().out), list)


def test_many_exposures_have_a_table_and_no_answer(examples, gs2ci, capsys):
    assert gs2ci("reconstruct", "shot.h5", "--all", "--json") == 2
    assert "runs.csv" in capsys.readouterr().err


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
