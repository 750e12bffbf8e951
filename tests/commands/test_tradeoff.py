import json
from dataclasses import replace

import numpy as np
import pytest

from gs2ci.api.costs import tradeoff as tradeoff_of
from gs2ci.commands import reconstruct, report, tradeoff
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot, Truth
from gs2ci.core.storage import read_shot, write_shots
from gs2ci.evaluate.tradeoff import exposures, trials

pytestmark = pytest.mark.usefixtures("undrawn")


@pytest.fixture
def measured(tmp_path):
    shot = Shot(np.ones((8, 8, 1), np.float32), np.ones((2, 8, 8), np.float32), np.ones(2, np.float32))
    return write_shots(tmp_path / "shot.h5", [shot])


@pytest.fixture
def tried(monkeypatch):
    """Trials that take no time, and the names of those that were tried."""
    names = []

    def instead(shot, trial, seed):
        names.append(trial.name)
        figures = {"psnr_db": 20.0 + len(names), "ssim": 0.5, "heldout_db": 15.0, "nate": None}
        return {"trial": trial.name, "knob": trial.knob, "seconds": 1.0 * len(names), **figures,
                "iterations": 1, "gaussians": 1}  # fmt: skip

    monkeypatch.setattr(trials, "tried", instead)
    return names


def test_the_ladder_is_tried_written_and_said(measured, tried, tmp_path, capsys):
    pages = tradeoff.run(measured, tmp_path / "out", knobs=("preset",), most="10h")
    assert [page.name for page in pages] == ["tradeoff.csv", "tradeoff.md", "tradeoff.html"]
    assert tried == ["decode", "draft", "standard", "paper"]
    assert "next decibel" in capsys.readouterr().out.replace("\n", " ")
    page = pages[2].read_text(encoding="utf-8")
    assert "The next decibel after standard costs" in page
    assert "<svg" in page


def test_an_answer_holds_the_trials_and_where_the_pages_are(measured, tried, tmp_path, gs2ci, capsys):
    assert gs2ci("tradeoff", measured, "-o", tmp_path / "out", "--knobs", "preset", "--most", "20s", "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    assert [trial["trial"] for trial in answer["trials"]] == tried
    assert answer["trials"][0]["psnr_db"] == 21.0
    assert answer["left_out_s"]["paper"] > 20
    assert answer["pages"] == [str(tmp_path / "out" / f"tradeoff.{ending}") for ending in ("csv", "md", "html")]


def test_what_would_take_too_long_is_left_out_and_said(measured, tried, tmp_path):
    pages = tradeoff.run(measured, tmp_path / "out", knobs=("preset",), most="20s")
    assert tried == ["decode", "draft", "standard"]
    assert "paper was left out" in pages[1].read_text()


def test_the_standard_and_what_is_quicker_are_tried_whatever_the_time_and_what_is_kept_counts_for_nothing(
    measured, tried, tmp_path
):
    tradeoff.run(measured, tmp_path / "out", knobs=("preset",), most="0.01s")
    assert tried == ["decode", "draft", "standard"]
    tradeoff.run(measured, tmp_path / "out", knobs=("preset",), most="10h")
    assert tried[3:] == ["paper"]
    assert "left out" not in tradeoff.run(measured, tmp_path / "out", knobs=("preset",), most="0.01s")[1].read_text()
    assert len(tried) == 4


def test_finished_trials_are_not_tried_again_unless_asked(measured, tried, tmp_path):
    for fresh, count in ((False, 4), (False, 4), (True, 8)):
        tradeoff.run(measured, tmp_path / "out", knobs=("preset",), most="10h", fresh=fresh)
        assert len(tried) == count


def test_a_shot_of_which_every_trial_fails_is_an_error_and_leaves_no_pages(measured, tmp_path, gs2ci, capsys):
    frame = replace(read_shot(measured), provenance={"mask_index": 0})
    file = write_shots(tmp_path / "frames.h5", [frame])
    assert gs2ci("tradeoff", file, "-o", tmp_path / "out", "--knobs", "preset") == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "every trial failed, 'decode' because of: " in told
    assert "frame of a single mask" in told
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["cells"]


def test_one_trial_that_fails_does_not_end_the_others(measured, tried, tmp_path, monkeypatch):
    good = trials.tried

    def fails(shot, trial, seed):
        if trial.name == "draft":
            raise InputError("no draft of this")
        return good(shot, trial, seed)

    monkeypatch.setattr(trials, "tried", fails)
    pages = tradeoff.run(measured, tmp_path / "out", knobs=("preset",), most="10h")
    assert "draft failed: no draft of this" in pages[1].read_text()


def test_a_shot_in_memory_has_trials_of_its_own_and_so_has_one_with_another_truth_or_origin(measured, tried, tmp_path):
    before = measured.read_bytes()
    shot = read_shot(measured)
    others = [
        replace(shot, measurement=shot.measurement / 2),
        replace(shot, truth=Truth(np.ones((2, 8, 8, 1), np.float32))),
        replace(shot, provenance={"from": "elsewhere"}),
    ]
    for count, one in enumerate([shot, *others], 1):
        for _ in range(2):  # the second time, what was tried is found
            tradeoff_of(one, tmp_path, knobs=("preset",), most="10h", progress=Silent())
        assert len(tried) == 4 * count
        assert len(list((tmp_path / "cells").iterdir())) == 4 * count
    assert measured.read_bytes() == before


def test_an_unknown_knob_and_a_seed_that_is_none_are_refused(measured, tried, tmp_path):
    with pytest.raises(InputError, match="no knob"):
        tradeoff.run(measured, tmp_path / "out", knobs=("luck",))
    with pytest.raises(InputError, match="--seed -1"):
        tradeoff.run(measured, tmp_path / "out", seed=-1)
    assert not (tmp_path / "out").exists()


@pytest.fixture
def folder(measured, tmp_path):
    """A run folder of the shot, as short as it can be."""
    return reconstruct.run(measured, tmp_path / "run", iterations=1)


def test_the_page_of_a_run_gets_the_section_and_keeps_it(measured, tried, folder, tmp_path):
    pages = tradeoff.run(measured, tmp_path / "out", knobs=("preset",), most="10h", report=folder)
    assert pages[-1] == folder / "report.html"
    page = pages[-1].read_text(encoding="utf-8")
    assert "What accuracy costs" in page
    assert "The next decibel after standard costs" in page
    assert report.run(folder).read_text(encoding="utf-8") == page


def test_a_run_of_another_shot_is_refused_before_anything_is_tried(measured, tried, folder, tmp_path):
    other = Shot(np.ones((8, 9, 1), np.float32), np.ones((2, 8, 9), np.float32), np.ones(2, np.float32))
    write_shots(tmp_path / "other.h5", [other])
    with pytest.raises(InputError, match="of another measurement"):
        tradeoff.run(tmp_path / "other.h5", tmp_path / "out", most="10h", report=folder)
    with pytest.raises(StorageError, match="cannot be read"):
        tradeoff.run(measured, tmp_path / "out", most="10h", report=tmp_path)
    assert tried == []
    assert not (folder / "tradeoff.json").exists()


def test_a_damaged_record_in_the_run_is_made_anew(measured, tried, folder, tmp_path):
    (folder / "tradeoff.json").write_text("{")
    tradeoff.run(measured, tmp_path / "out", knobs=("preset",), most="10h", report=folder)
    assert "What accuracy costs" in report.run(folder).read_text(encoding="utf-8")


def test_exposures_are_tried_together_only_if_asked_for(tried, tmp_path, monkeypatch, capsys):
    shots = [Shot(np.ones((8, 8, 1), np.float32), np.ones((2, 8, 8), np.float32), name=f"shot {k}") for k in range(4)]
    path = write_shots(tmp_path / "shots.h5", shots)
    given = []

    def together(shots, trial, seed):
        given.append([shot.name for shot in shots[: trial.exposures]])
        figures = {"psnr_db": 20.0 + trial.exposures, "ssim": 0.5, "heldout_db": 15.0, "nate": None}
        return {"trial": trial.name, "knob": trial.knob, "seconds": 2.0 * trial.exposures, **figures, "iterations": 1,
                "gaussians": 1, "exposures": trial.exposures, "capture_s": 0.5 * trial.exposures}  # fmt: skip

    monkeypatch.setattr(exposures, "tried_together", together)
    pages = tradeoff.run(path, tmp_path / "out", knobs=("exposures",), index=1)
    assert tried == ["standard"]
    assert given == [["shot 1"], ["shot 1", "shot 0"], ["shot 1", "shot 0", "shot 2", "shot 3"]]
    assert "against exposures: 21.00 dB with 1 to 24.00 dB with 4" in pages[2].read_text()
    assert "The next exposure after 4 is worth" in capsys.readouterr().out.replace("\n", " ")
    assert "capture_s" in pages[0].read_text().splitlines()[0]
    tradeoff.run(path, tmp_path / "out", knobs=("exposures",), index=1)
    assert len(given) == 3  # kept


def test_exposures_of_a_file_that_has_one_are_refused(measured, tried, tmp_path):
    with pytest.raises(InputError, match="1 exposure"):
        tradeoff.run(measured, tmp_path / "out", knobs=("exposures",))
    assert tried == []


def test_an_interrupted_command_goes_on_with_the_trials_that_are_left(measured, tried, tmp_path, monkeypatch, capsys):
    whole = trials.tried

    def interrupted(shot, trial, seed):
        if trial.name == "standard":
            raise KeyboardInterrupt
        return whole(shot, trial, seed)

    with monkeypatch.context() as patched:
        patched.setattr(trials, "tried", interrupted)
        with pytest.raises(KeyboardInterrupt):
            tradeoff.run(measured, tmp_path / "out", knobs=("preset",), most="10h")
    assert capsys.readouterr().err == "finished trials are kept: the same command goes on with the others\n"
    assert tried == ["decode", "draft"]
    tradeoff.run(measured, tmp_path / "out", knobs=("preset",), most="10h")
    assert tried == ["decode", "draft", "standard", "paper"]
