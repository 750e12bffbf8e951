"""`gs2ci reconstruct --together`: which exposures share a scene, and the run folder."""

import io
import json
import signal

import numpy as np
import pytest
from rich.console import Console

import gs2ci
from gs2ci.api import display
from gs2ci.api.shots import every_exposure
from gs2ci.api.summary import print_summary
from gs2ci.commands import evaluate, reconstruct
from gs2ci.commands.reconstruct import chosen_exposures
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.storage import write_shots
from gs2ci.evaluate.report import read_report
from tests.exposed_rooms import adjacent, room

SIZE = (32, 40)
QUICK = {"preset": "draft", "iterations": 12, "registration": "off"}


@pytest.fixture(scope="module")
def shots():
    return adjacent(room(0, SIZE), SIZE, 0, 2)


@pytest.fixture(scope="module")
def files(shots, tmp_path_factory):
    folder = tmp_path_factory.mktemp("shots")
    return [write_shots(folder / f"{number}.h5", [shot]) for number, shot in enumerate(shots)]


@pytest.fixture(scope="module")
def folder(files, tmp_path_factory):
    output = tmp_path_factory.mktemp("run") / "run"
    return reconstruct.run(files[0], output, more=(files[1],), together=True, **QUICK)


@pytest.mark.slow
def test_the_run_folder_holds_the_views_of_all_exposures(folder, shots):
    report = read_report(folder)
    assert report.views == 16
    assert [(one.name, one.first_view, one.views) for one in report.exposures] == [("path 0", 0, 8), ("path 1", 8, 8)]
    assert report.trajectory is not None
    assert len(json.loads((folder / "cameras.json").read_text())["frames"]) == 16
    page = (folder / "report.html").read_text()
    assert "from 2 exposures" in page
    assert "path 1" in page
    assert "seen by it alone" in page
    assert all(0 <= one.seen_alone <= 1 for one in report.exposures)
    run = gs2ci.open_run(folder)
    assert run.views.shape == (16, *SIZE, 3)
    assert run.depth.shape == (16, *SIZE)


@pytest.mark.slow
def test_its_summary_counts_the_exposures(folder):
    console = Console(file=io.StringIO(), width=100)
    print_summary(folder, console)
    assert "path 0 and 1 more: 16 views from 2 exposures" in console.file.getvalue()
    assert "16 views from 2 exposures" in gs2ci.open_run(folder)._repr_html_()


@pytest.mark.slow
def test_what_is_kept_meanwhile_is_gone_in_the_end(folder):
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]


@pytest.mark.slow
def test_a_command_that_fails_in_the_end_goes_on_from_there(folder, files, tmp_path, monkeypatch, capsys):
    output = tmp_path / "run"

    def full(*_, **__):
        raise StorageError("no room")

    with monkeypatch.context() as patched:
        patched.setattr("gs2ci.evaluate.run_folder.write_run", full)
        with pytest.raises(StorageError, match="no room"):
            reconstruct.run(files[0], output, more=(files[1],), together=True, **QUICK)
    assert [path.name for path in tmp_path.iterdir()] == [".run.unfinished"]
    capsys.readouterr()
    reconstruct.run(files[0], output, more=(files[1],), together=True, **QUICK)
    assert "goes on: 2 exposures observed, the fit is over." in " ".join(capsys.readouterr().out.split())
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    assert np.array_equal(gs2ci.open_run(output).views, gs2ci.open_run(folder).views)


def test_an_interrupted_command_says_where_it_goes_on(files, tmp_path, monkeypatch, capsys):
    def interrupted(*_, unfinished, **__):
        unfinished.mkdir()
        raise KeyboardInterrupt

    monkeypatch.setattr("gs2ci.api.reconstruction.reconstruct", interrupted)
    with pytest.raises(KeyboardInterrupt):
        reconstruct.run(files[0], tmp_path / "run", more=(files[1],), together=True, **QUICK)
    kept = tmp_path / ".run.unfinished"
    assert capsys.readouterr().err == f"what is done is kept in {kept}: the same command goes on from there\n"


@pytest.mark.slow
def test_an_interrupted_fit_is_written_and_goes_on_all_the_same(folder, files, tmp_path, monkeypatch, capsys):
    class Interrupting(gs2ci.Silent):
        fits = False

        def stage(self, name, total=None):
            self.fits = name == "fit"

        def step(self, done, **figures):
            if self.fits and done == 5:
                signal.raise_signal(signal.SIGINT)

    output = tmp_path / "run"
    with monkeypatch.context() as patched:
        patched.setattr(reconstruct, "open_display", lambda: display.shown(Interrupting()))
        with pytest.raises(KeyboardInterrupt):
            reconstruct.run(files[0], output, more=(files[1],), together=True, **QUICK)
    assert gs2ci.open_run(output).interrupted
    kept = tmp_path / ".run.unfinished"
    again = f"what is done is kept in {kept}: the same command with --overwrite goes on from there\n"
    assert capsys.readouterr().err == again
    reconstruct.run(files[0], output, more=(files[1],), together=True, overwrite=True, **QUICK)
    assert "An unfinished run in" in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    assert np.array_equal(gs2ci.open_run(output).views, gs2ci.open_run(folder).views)


def test_one_exposure_is_never_unfinished(shots, tmp_path):
    with pytest.raises(InputError, match="together=True"):
        gs2ci.reconstruct(shots[0], unfinished=tmp_path / "kept")


@pytest.mark.slow
def test_python_takes_a_list_or_a_file_of_several(folder, shots, files):
    found = gs2ci.reconstruct(shots, together=True, progress=gs2ci.Silent(), **QUICK)
    assert np.array_equal(found.views, gs2ci.open_run(folder).views)
    alone = gs2ci.reconstruct(files[0], together=True, progress=gs2ci.Silent(), **QUICK)
    assert alone.views.shape == (8, *SIZE, 3)
    assert alone.report.exposures == []


@pytest.mark.slow
def test_the_run_is_evaluated_against_the_truths_of_its_exposures(folder, shots, files, tmp_path, capsys):
    written = evaluate.run(folder, files[1], tmp_path / "found.json", more=(files[0],))
    found, report = json.loads(written.read_text()), read_report(folder)
    assert [one["name"] for one in found["exposures"]] == ["path 0", "path 1"]
    assert found["psnr_db"]["mean"] == pytest.approx(report.psnr_db.mean)
    assert found["trajectory"]["nate"] == pytest.approx(report.trajectory.nate)
    assert found["notes"] == []
    assert "path 1 (views 9 to 16)" in capsys.readouterr().out
    assert gs2ci.evaluate(folder, list(shots)) == found
    assert gs2ci.evaluate(folder, [str(file) for file in files], index=0) == found
    assert gs2ci.evaluate(folder, [files[0], shots[1]]) == found
    with pytest.raises(InputError, match="path 1 is missing"):
        gs2ci.evaluate(folder, shots[0])
    with pytest.raises(InputError, match="path 1 is missing"):
        evaluate.run(folder, files[0], tmp_path / "found.json", index="0:1")


def test_several_shots_are_reconstructed_together_only_if_that_is_asked_for(shots):
    with pytest.raises(InputError, match="2 shots to reconstruct"):
        gs2ci.reconstruct(shots, progress=gs2ci.Silent())
    with pytest.raises(InputError, match="no exposure to reconstruct"):
        gs2ci.reconstruct([], together=True, progress=gs2ci.Silent())
    with pytest.raises(InputError, match="within a budget"):
        gs2ci.reconstruct(shots, together=True, budget="60s", progress=gs2ci.Silent())


@pytest.fixture(scope="module")
def three(shots, tmp_path_factory):
    """One file of three exposures under the same masks."""
    return write_shots(tmp_path_factory.mktemp("three") / "shots.h5", [shots[0]] * 3)


def test_exposures_of_one_name_are_called_after_their_files(three, shots, tmp_path):
    other = write_shots(tmp_path / "b.h5", [shots[0]])
    assert [shot.name for shot in chosen_exposures([three], "1:")] == ["shots-1", "shots-2"]
    names = ["shots-0", "shots-1", "shots-2", "b"]
    assert [shot.name for shot in chosen_exposures([three, other], None)] == names
    assert [shot.name for shot in every_exposure([three, other], together=True)] == names
    assert [shot.name for shot in every_exposure([other, shots[1]], together=True)] == ["path 0", "path 1"]
    assert [shot.name for shot in every_exposure([shots[0], shots[0]], together=True)] == ["path 0", "path 0"]


def test_an_index_chooses_exposures_of_each_file(three, files):
    assert [len(chosen_exposures([three], index)) for index in (None, 1, "1", "0:2", "1:", ":1")] == [3, 1, 1, 2, 2, 1]
    assert len(chosen_exposures([three, files[0]], None)) == 4


@pytest.mark.parametrize("index", ["a", "0:b", "-1:2", -1, "", "7", "3:9"])
def test_an_index_that_names_none_is_refused(three, index):
    with pytest.raises(InputError, match=r"--index|no exposures"):
        chosen_exposures([three], index)


@pytest.mark.parametrize(
    "options", [{"explain_plan": True}, {"moments": 3}, {"processes": 2}, {"scheduler": "tcp://one:8786"}]
)
def test_what_several_exposures_cannot_have_is_refused(files, tmp_path, options):
    with pytest.raises(InputError, match="--together with"):
        reconstruct.run(files[0], tmp_path / "run", together=True, **options)


def test_a_range_is_refused_where_exposures_share_no_scene(three, tmp_path):
    with pytest.raises(InputError, match="only with --together"):
        reconstruct.run(three, tmp_path / "run", index="0:2")
