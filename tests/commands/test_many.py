"""What the arguments of `gs2ci reconstruct` mean for many exposures."""

import json
from pathlib import Path

import h5py
import jsonschema
import numpy as np
import pytest

from gs2ci.api.many import reconstruct_many
from gs2ci.batch import reconstruct as batch
from gs2ci.batch.rows import Row, RowProblem
from gs2ci.core.errors import InputError
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.core.storage import write_shots

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def files(tmp_path, monkeypatch):
    masks = np.ones((2, 8, 8), np.float32)
    shot = Shot(np.ones((8, 8, 1), np.float32), masks, np.ones(2, np.float32))
    monkeypatch.chdir(tmp_path)
    return [write_shots(tmp_path / f"{name}.h5", [shot, shot]) for name in "ab"]


@pytest.fixture
def asked(monkeypatch):
    """What the batch was asked for; everything succeeds but exposures of the file "b"."""
    calls = []

    def answer(exposures, output, settings, **options):
        calls.append((exposures, settings, options))
        problem = RowProblem(kind="GeometryError", problem="no path")
        return [
            Row(name=one.name, state=state, file="", index=0, key="", problem=problem if state == "failed" else None)
            for one in exposures
            for state in ("failed" if one.name.startswith("b") else "done",)
        ]

    monkeypatch.setattr(batch, "reconstruct_many", answer)
    return calls


def test_all_takes_every_exposure_of_every_file_and_a_failure_is_the_exit_status(gs2ci, files, asked, capsys):
    assert gs2ci("reconstruct", *files, "--all", "-o", "runs", "--seed", "7", "--processes", "2") == 2
    (exposures, settings, options) = asked[0]
    assert [one.name for one in exposures] == ["a-000", "a-001", "b-000", "b-001"]
    assert (settings.seed, options["processes"]) == (7, 2)
    said = capsys.readouterr()
    assert "runs/index.html" in said.out
    assert "2 of 4 exposures have no run, b-000 the first of them" in said.err


def test_the_rows_are_the_answer_also_where_some_failed(gs2ci, files, asked, capsys):
    assert gs2ci("reconstruct", *files, "--all", "-o", "runs", "--json") == 2
    rows = json.loads(capsys.readouterr().out)
    assert [row["state"] for row in rows] == ["done", "done", "failed", "failed"]
    schema = json.loads((ROOT / "docs" / "batch-row.schema.json").read_text())
    for row in rows:
        jsonschema.validate(row, schema)
    assert rows[2]["problem"]["problem"] == "no path"


def test_one_file_with_all_is_many(gs2ci, files, asked):
    assert gs2ci("reconstruct", files[0], "--all", "-o", "runs") == 0
    assert len(asked[0][0]) == 2


def test_several_files_without_all_give_one_each(gs2ci, files, asked):
    gs2ci("reconstruct", *files, "--index", "1", "-o", "runs")
    assert [one.name for one in asked[0][0]] == ["a-001", "b-001"]


def test_every_exposure_and_one_of_them_are_not_asked_for_together(gs2ci, files, asked, capsys):
    for index in ("0", "1"):
        assert gs2ci("reconstruct", files[0], "--all", "--index", index, "-o", "runs") == 2
        assert f"both --all and --index {index}" in capsys.readouterr().err
    with pytest.raises(InputError, match=r"both --all and --index 1.*every=False"):
        reconstruct_many(files, "runs", index=1)
    assert not asked
    reconstruct_many(files, "runs", every=False, index=1)
    assert [one.name for one in asked[0][0]] == ["a-001", "b-001"]


@pytest.fixture
def damaged(files):
    """A file whose first exposure cannot be read, and one that has other masks."""
    with h5py.File(files[0], "r+") as file:
        file["meas"][0] = np.nan
    masks = np.ones((3, 9, 9), np.float32)
    larger = Shot(np.ones((9, 9, 1), np.float32), masks, np.ones(3, np.float32))
    return [files[0], write_shots(files[0].with_name("larger.h5"), [larger])]


def test_a_damaged_exposure_stops_none_of_the_others(damaged, asked, monkeypatch):
    pixels = []
    monkeypatch.setattr(batch, "bearable_processes", lambda most: pixels.append(most) or 2)
    reconstruct_many(damaged, "runs")
    assert len(asked[0][0]) == 3
    assert asked[0][2]["processes"] == 2
    assert pixels == [3 * 9 * 9]


@pytest.mark.parametrize("where", [{"processes": 2}, {"scheduler": "tcp://x:1"}], ids=lambda where: next(iter(where)))
def test_no_exposure_is_read_where_its_size_decides_nothing(files, asked, monkeypatch, where):
    monkeypatch.setattr("gs2ci.batch.exposures.read_shot", None)
    reconstruct_many(files, "runs", **where)
    assert len(asked[0][0]) == 4


def test_a_damaged_exposure_becomes_a_row_with_its_error(damaged):
    overrides = {"fits": 1, "iterations": 1, "motion": "off", "processes": 1, "progress": Silent()}
    first, _second = reconstruct_many(damaged[:1], "runs", "draft", **overrides)
    assert (first.state, first.problem.kind) == ("failed", "StorageError")


def test_results_depend_on_every_override(gs2ci, files, asked):
    for more in ([], ["--focal-px", "50"], ["--preset", "draft"], ["--geometry", "wide"]):
        gs2ci("reconstruct", files[0], "--all", *more)
    assert len({options["depends_on"] for _, _, options in asked}) == 4


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--budget", "60s"], "--budget for many exposures"),
        (["--processes", "2", "--scheduler", "tcp://x:1"], "--processes and --scheduler together"),
        (["--processes", "0"], "--processes 0"),
        (["--index", "2"], "a.h5 has no exposure 2"),
    ],
)
def test_what_makes_no_sense_is_refused(gs2ci, files, asked, capsys, arguments, said):
    assert gs2ci("reconstruct", *files, *arguments) == 2
    assert said in capsys.readouterr().err
    assert not asked


def test_an_interrupted_command_says_that_finished_runs_are_kept(gs2ci, files, monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(batch, "reconstruct_many", interrupted)
    assert gs2ci("reconstruct", *files, "--all", "-o", "runs") == 130
    assert "finished runs are kept: the same command goes on with the others\n" in capsys.readouterr().err
