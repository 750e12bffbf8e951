import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gs2ci.core.errors import InputError, NumericsError, StorageError
from gs2ci.evaluate.decode_folder import SCHEMA, Decoded, write_decoded
from gs2ci.evaluate.whole_folder import check_destination


@pytest.fixture
def decoded(make_run):
    shot, result = make_run(count=3, size=(24, 32))
    return Decoded(shot, result.views, shot.measurement, 1.5, {"name": "gap-tv", "iterations": 40}, ("A note.",))


def test_the_folder_holds_views_pictures_and_report(tmp_path, decoded):
    dark = replace(decoded, views=decoded.views - 2, seconds=0.5)
    report = write_decoded(tmp_path / "out", [decoded, dark])
    views = np.load(tmp_path / "out" / "views.npy")
    assert np.array_equal(views, np.concatenate([decoded.views, dark.views]))
    pictures = sorted((tmp_path / "out" / "views").iterdir())
    assert len(pictures) == 6
    first = cv2.imread(str(pictures[0]))[..., ::-1]
    assert np.array_equal(first, np.round(255 * np.clip(decoded.views[0], 0, 1)))
    assert not cv2.imread(str(pictures[5])).any()
    assert json.loads((tmp_path / "out" / "report.json").read_text()) == report
    assert (report["schema"], report["views"], report["size"], report["seconds"]) == (SCHEMA, 3, [24, 32], 2.0)
    assert [shot["seconds"] for shot in report["shots"]] == [1.5, 0.5]
    assert report["shots"][0]["residual"]["rms"] == 0
    assert report["psnr_db"] == pytest.approx(np.mean([shot["psnr_db"] for shot in report["shots"]]))


def test_without_truth_there_is_no_score(tmp_path, make_run):
    shot, result = make_run(count=2, size=(24, 32), channels=1, truth=False)
    report = write_decoded(tmp_path / "out", [Decoded(shot, result.views, shot.measurement, 1.0, {"name": "eni"})])
    assert report["psnr_db"] is report["ssim"] is report["shots"][0]["psnr_db"] is None


def test_an_earlier_decode_is_replaced_only_when_asked(tmp_path, decoded):
    write_decoded(tmp_path / "out", [decoded, decoded])
    with pytest.raises(StorageError, match="not empty"):
        write_decoded(tmp_path / "out", [decoded])
    write_decoded(tmp_path / "out", [decoded], overwrite=True)
    assert len(np.load(tmp_path / "out" / "views.npy")) == 3


def test_a_run_is_not_replaced_by_a_decode_nor_a_decode_by_a_run(tmp_path, decoded):
    write_decoded(tmp_path / "out", [decoded])
    with pytest.raises(StorageError, match="something other than a run"):
        check_destination(tmp_path / "out", overwrite=True)
    (tmp_path / "out" / "report.json").write_text('{"schema": "gs2ci.report/1"}')
    with pytest.raises(StorageError, match="something other than a run"):
        write_decoded(tmp_path / "out", [decoded], overwrite=True)


def test_views_that_are_not_finite_are_not_written(tmp_path, decoded):
    views = decoded.views.copy()
    views[0, 0, 0, 0] = np.nan
    with pytest.raises(NumericsError, match="not finite"):
        write_decoded(tmp_path / "out", [replace(decoded, views=views)])
    assert not list(tmp_path.iterdir())


def test_nothing_is_not_written(tmp_path):
    with pytest.raises(InputError, match="no decoded shot"):
        write_decoded(tmp_path / "out", [])


def test_a_picture_that_cannot_be_written_leaves_nothing(tmp_path, decoded, monkeypatch):
    def full(path: Path, content: bytes) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(StorageError, match="cannot be written"):
        write_decoded(tmp_path / "out", [decoded])
    assert not list(tmp_path.iterdir())
