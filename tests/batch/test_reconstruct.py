"""Many exposures, in this process: what is done, what is kept, what is said."""

import csv
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gs2ci.batch.exposures import list_exposures
from gs2ci.batch.reconstruct import bearable_processes, reconstruct_many
from gs2ci.batch.rows import read_row
from gs2ci.core.errors import GeometryError, InputError, StorageError
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.core.storage import write_shots
from gs2ci.evaluate.report import read_report
from gs2ci.reconstruct.presets.named import PRESETS

pytestmark = pytest.mark.usefixtures("undrawn")

QUICK = replace(PRESETS["draft"], fit=replace(PRESETS["draft"].fit, iterations=1))
FILES = {"report.json", "report.html", "views.npy"}


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    draws = np.random.default_rng(0)
    masks = (draws.random((3, 16, 20)) < 0.5).astype(np.float32)
    shots = [
        Shot(
            measurement=draws.random((16, 20, 1), dtype=np.float32),
            masks=masks,
            weights=np.ones(3, np.float32),
            name=f"shot {k}",
        )
        for k in range(2)
    ]
    return write_shots(tmp_path_factory.mktemp("shots") / "a.h5", shots)


@pytest.fixture(scope="module")
def finished(file, tmp_path_factory):
    """A folder of two runs."""
    output = tmp_path_factory.mktemp("batch") / "runs"
    rows = reconstruct_many(list_exposures([file], every=True), output, QUICK)
    assert [row.state for row in rows] == ["done", "done"]
    return output


def refuse(shot):
    if shot.name == "shot 0":
        raise GeometryError("no path in shot 0", remedy="move the camera")
    raise ZeroDivisionError("a slip")


def unwanted(_shot):
    raise AssertionError("this was done already")


def test_every_exposure_gets_a_whole_run_folder_of_its_own(finished):
    for k in range(2):
        folder = finished / f"a-{k:03d}"
        assert {path.name for path in folder.iterdir()} >= FILES
        assert read_report(folder).name == f"shot {k}"


def test_the_csv_holds_a_line_for_each_with_the_figures_of_its_report(finished):
    with (finished / "runs.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [line["name"] for line in lines] == ["a-000", "a-001"]
    report = read_report(finished / "a-001")
    assert float(lines[1]["residual_rms"]) == report.residual.rms
    assert lines[1]["psnr_db"] == ""


def hold(shot):
    if shot.name == "shot 0":
        np.ones(300 * 2**17).sum()  # 300 MiB, given back at once
    return shot


def peaks(file, output):
    """Print the peaks of both runs: asked of a process of its own, whose memory no other test has used.

    They are done twice: the first time also loads libraries, which stay.
    """
    for folder in ("first", "again"):
        rows = reconstruct_many(list_exposures([Path(file)], every=True), Path(output, folder), QUICK, prepare=hold)
    print(json.dumps([row.peak_mib for row in rows]))


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="only Linux restarts the peak")
def test_each_run_has_its_own_peak_of_memory(file, tmp_path):
    code = f"from tests.batch.test_reconstruct import peaks; peaks(*{[str(file), str(tmp_path)]})"
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, cwd=Path(__file__).parents[2]
    )
    first, second = json.loads(done.stdout.splitlines()[-1])
    assert second < first - 100


def test_the_page_links_to_every_run(finished):
    page = (finished / "index.html").read_text()
    assert all(f'href="a-{k:03d}/report.html"' in page for k in range(2))
    assert "2 of 2 exposures reconstructed" in page


def test_what_is_done_is_not_done_again(finished, file):
    said = Silent()
    before = (finished / "a-000" / "report.json").stat().st_mtime_ns
    rows = reconstruct_many(list_exposures([file], every=True), finished, QUICK, prepare=unwanted, progress=said)
    assert [row.state for row in rows] == ["done", "done"]
    assert (finished / "a-000" / "report.json").stat().st_mtime_ns == before
    assert said.sentences == ["2 of 2 are done already."]


def test_runs_made_with_other_settings_are_not_replaced_unasked(finished, file):
    other = replace(QUICK, seed=7)
    with pytest.raises(StorageError, match="with other settings"):
        reconstruct_many(list_exposures([file], every=True), finished, other)
    rows = reconstruct_many(list_exposures([file], every=False), finished, other, overwrite=True)
    assert read_report(finished / "a-000").seed == 7
    assert rows[0].state == "done"


def test_a_strangers_folder_is_not_replaced(file, tmp_path):
    (tmp_path / "a-000").mkdir()
    (tmp_path / "a-000" / "thesis.tex").write_text("years")
    with pytest.raises(StorageError, match="something other than a run"):
        reconstruct_many(list_exposures([file], every=True), tmp_path, QUICK, overwrite=True)


def test_an_exposure_that_cannot_be_solved_ends_as_a_row_with_its_error(file, tmp_path):
    rows = reconstruct_many(list_exposures([file], every=True), tmp_path, QUICK, prepare=refuse)
    assert [row.state for row in rows] == ["failed", "failed"]
    assert (rows[0].problem.kind, rows[0].problem.remedy) == ("GeometryError", "move the camera")
    assert rows[1].problem.kind == "ZeroDivisionError"
    assert "refuse" in rows[1].problem.trace
    assert json.loads((tmp_path / "rows" / "a-000.json").read_text())["state"] == "failed"
    assert "no path in shot 0" in (tmp_path / "index.html").read_text()
    assert "GeometryError,no path in shot 0" in (tmp_path / "runs.csv").read_text()


def test_what_failed_is_tried_again(file, tmp_path):
    exposures = list_exposures([file], every=False)
    reconstruct_many(exposures, tmp_path, QUICK, prepare=refuse)
    assert [row.state for row in reconstruct_many(exposures, tmp_path, QUICK)] == ["done"]


def test_a_run_whose_row_was_lost_is_done_again(finished, file):
    exposures = list_exposures([file], every=True)[1:]
    (finished / "rows" / "a-001.json").write_text("{cut sh")
    assert [row.state for row in reconstruct_many(exposures, finished, QUICK)] == ["done"]
    assert read_row(finished, "a-001").state == "done"


def test_no_row_vouches_for_a_run_that_it_is_not_of(file, tmp_path, monkeypatch):
    exposures = list_exposures([file], every=False)
    (first,) = reconstruct_many(exposures, tmp_path, QUICK)

    def killed(*_arguments, **_options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("gs2ci.batch.work.row_of", killed)
        with pytest.raises(KeyboardInterrupt):
            reconstruct_many(exposures, tmp_path, replace(QUICK, seed=7), overwrite=True)
    assert read_report(tmp_path / "a-000").seed == 7
    assert read_row(tmp_path, "a-000") is None
    (again,) = reconstruct_many(exposures, tmp_path, QUICK)
    assert read_report(tmp_path / "a-000").seed == QUICK.seed
    assert again.residual_rms == first.residual_rms


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_run_whose_folder_was_deleted_is_done_again(finished, file, overwrite):
    shutil.rmtree(finished / "a-001")
    (row,) = reconstruct_many(list_exposures([file], every=True)[1:], finished, QUICK, overwrite=overwrite)
    assert row.state == "done"
    assert read_report(finished / "a-001").residual.rms == row.residual_rms


def test_what_killed_workers_left_half_written_is_removed(finished, file, monkeypatch):
    monkeypatch.setattr("gs2ci.batch.reconstruct._ABANDONED_S", -1.0)  # no time of a change can be set in a test
    left = [finished / name for name in (".a-000.123.partial", ".a-001.9.old")]
    other = finished / ".cache.1.partial"
    for folder in (*left, other):
        folder.mkdir()
    reconstruct_many(list_exposures([file], every=True)[1:], finished, QUICK, overwrite=True)
    assert [folder.exists() for folder in (*left, other)] == [
        True,
        False,
        True,
    ]  # the first is of no exposure asked for


def test_what_another_command_is_writing_into_the_same_folder_stays(finished, file):
    kept = [finished / name for name in (".a-001.123.partial", ".a-001.9.old")]
    for folder in kept:
        folder.mkdir()
    os.utime(kept[1], (0, 0))  # an earlier run of long ago, set aside just now
    reconstruct_many(list_exposures([file], every=True)[1:], finished, QUICK, overwrite=True)
    assert [folder.exists() for folder in kept] == [True, True]


def test_a_file_that_is_gone_when_the_worker_looks_is_a_row(file, tmp_path):
    (one,) = list_exposures([file], every=False)
    (row,) = reconstruct_many([replace(one, file=tmp_path / "gone.h5")], tmp_path, QUICK)
    assert "is not to be seen from" in row.problem.problem


def test_an_interruption_leaves_page_and_csv_of_what_there_is(file, tmp_path):
    class Impatient(Silent):
        def step(self, done, **_):
            if done == 1:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reconstruct_many(list_exposures([file], every=True), tmp_path, QUICK, progress=Impatient())
    assert "1 of 1 exposures" in (tmp_path / "index.html").read_text()
    assert len((tmp_path / "runs.csv").read_text().splitlines()) == 2


def test_a_machine_bears_at_least_one_process_and_no_more_than_its_memory_holds(monkeypatch):
    monkeypatch.setattr("gs2ci.batch.reconstruct.machine", lambda: SimpleNamespace(usable_cores=64))
    assert bearable_processes(10**12) == 1
    assert 1 <= bearable_processes(8 * 96 * 128) <= 64


def test_no_scheduler_is_asked_where_nothing_is_to_be_done(finished, file):
    exposures = list_exposures([file], every=True)[1:]
    assert reconstruct_many(exposures, finished, QUICK, scheduler="tcp://127.0.0.1:9")[0].state == "done"


def test_a_scheduler_that_does_not_answer_is_refused(file, tmp_path, monkeypatch):
    monkeypatch.setattr("gs2ci.batch.cluster.CONNECT_S", 0.2)
    with pytest.raises(InputError, match="no Dask scheduler answers"):
        reconstruct_many(list_exposures([file], every=True), tmp_path, QUICK, scheduler="tcp://127.0.0.1:9")


def test_processes_without_dask_say_what_to_install(file, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "dask", None)
    with pytest.raises(InputError, match="gs2ci\\[cluster\\]"):
        reconstruct_many(list_exposures([file], every=True), tmp_path, QUICK, processes=2)


def test_a_run_does_not_become_a_folder_of_runs(file, finished, tmp_path):
    single = tmp_path / "run"
    shutil.copytree(finished / "a-000", single)
    before = sorted(single.rglob("*"))
    with pytest.raises(StorageError, match=r"run holds a result of its own, report\.json.*another place"):
        reconstruct_many(list_exposures([file], every=True), single, QUICK, overwrite=True)
    assert sorted(single.rglob("*")) == before
