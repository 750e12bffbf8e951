import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.commands import evaluate
from gs2ci.core.errors import InputError, StorageError
from gs2ci.core.findings import Code, finding
from gs2ci.core.records import Shot, Truth
from gs2ci.core.run_figures import VERDICTS
from gs2ci.core.run_records import RunResult
from gs2ci.core.storage import read_shot, write_shots
from gs2ci.evaluate.run_folder import write_run
from gs2ci.reconstruct.paper import perceptual
from gs2ci.render.gaussians import Gaussians

SIZE, VIEWS = (12, 16), 3


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A folder with a shot file and the run folder of a grey wall that was recovered nearly right."""
    folder = tmp_path_factory.mktemp("written")
    grey = np.full((VIEWS, *SIZE, 3), 0.5, np.float32)
    masks = np.ones((VIEWS, *SIZE), np.float32)
    poses = np.tile(np.eye(4), (VIEWS, 1, 1))
    poses[:, 0, 3] = 0.1 * np.arange(VIEWS)
    shot = Shot(VIEWS * grey[0], masks, np.ones(VIEWS, np.float32), truth=Truth(grey, poses))
    result = RunResult(
        views=grey + np.float32(0.01), scene_views=grey, depth=grey[..., 0], world_to_camera=poses,
        intrinsics=np.array([[20.0, 0, 8], [0, 20, 6], [0, 0, 1]]), decode=grey, predicted_measurement=VIEWS * grey[0],
        curve=(), stopped=finding(Code.FIT_STALLED, best=1),
        seconds=dict.fromkeys(("total", "decode", "geometry", "fit"), 1.0),
        gaussians=1, notes=(), settings={}, seed=0, verdict="refined", heldout_rms=dict.fromkeys(VERDICTS),
    )  # fmt: skip
    one = torch.zeros(1, 3)
    scene = Gaussians(one + torch.tensor([0, 0, 1.0]), one, torch.tensor([[1.0, 0, 0, 0]]), torch.zeros(1), one)
    write_shots(folder / "shot.h5", [shot])
    write_run(folder / "run", shot, result, scene)
    return folder


@pytest.fixture
def finished(written, tmp_path):
    """The two, copied: to draw a run anew takes forty times as long."""
    shutil.copytree(written, tmp_path, dirs_exist_ok=True)
    return tmp_path / "shot.h5", tmp_path / "run"


def test_all_figures_are_printed_and_written(finished, tmp_path, capsys):
    shot, folder = finished
    np.save(tmp_path / "depth.npy", np.full((VIEWS, *SIZE), 3.0))
    np.savez(tmp_path / "novel.npz", views=np.zeros((1, *SIZE, 3)), world_to_camera=np.eye(4)[None])
    written = evaluate.run(
        folder, shot, depth=tmp_path / "depth.npy", novel=tmp_path / "novel.npz", read_noise=0.01 * VIEWS, electrons=1e9
    )
    assert written == folder / "evaluation.json"
    found = json.loads(written.read_text())
    assert found["psnr_db"]["mean"] == pytest.approx(40, abs=0.01)
    assert found["residual"]["chi2_per_pixel"] == pytest.approx(1, abs=0.01)
    said = capsys.readouterr().out
    for name in ("PSNR", "SSIM", "nATE", "RPE, rotation", "depth", "χ² per pixel", "novel views PSNR"):
        assert name in said


def test_the_result_goes_where_it_is_asked_to(finished, tmp_path):
    shot, folder = finished
    assert evaluate.run(folder, shot, tmp_path / "other.json") == tmp_path / "other.json"
    assert not (folder / "evaluation.json").exists()
    assert evaluate.run(folder, shot, tmp_path / "other.json") == tmp_path / "other.json"


@pytest.mark.parametrize("name", ["shot.h5", "depth.npy", "run/report.json", "run/scene.ply", "run", "link"])
def test_inputs_and_files_of_others_are_not_replaced(finished, tmp_path, name):
    shot, folder = finished
    np.save(tmp_path / "depth.npy", np.full((VIEWS, *SIZE), 3.0))
    (tmp_path / "link").symlink_to(shot)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(StorageError, match=rf"{name} exists and is not an evaluation of gs2ci.*choose another place"):
        evaluate.run(folder, shot, tmp_path / name, depth=tmp_path / "depth.npy")
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_brackets_in_a_path_are_no_markup(finished, tmp_path, capsys):
    shot, folder = finished
    (tmp_path / "ev[").mkdir()
    for name in ("ev[draft].json", "ev[/x].json"):
        assert evaluate.run(folder, shot, tmp_path / name) == tmp_path / name
        assert str(tmp_path / name) in capsys.readouterr().out


@pytest.mark.parametrize("content", [b"", b"no numbers", b"\x93NUMPY\x01\x00 and no more", None])
def test_depth_that_cannot_be_read_is_refused(finished, tmp_path, content):
    shot, folder = finished
    path = tmp_path / "depth.npy"
    if content is None:
        np.save(path, np.zeros(3))
    else:
        path.write_bytes(content)
    with pytest.raises(InputError, match="depth"):
        evaluate.run(folder, shot, depth=path)


def test_a_perceptual_model_that_is_not_there_is_refused(finished, tmp_path):
    shot, folder = finished
    with pytest.raises(InputError, match=r"absent\.onnx"):
        evaluate.run(folder, shot, lpips=str(tmp_path / "absent.onnx"))


def test_a_perceptual_distance_is_printed_beside_the_others(finished, monkeypatch, capsys):
    shot, folder = finished
    asked = []

    def load(name):
        asked.append(name)
        return lambda image, target: (image - target).abs().mean()

    monkeypatch.setattr(perceptual, "load_distance", load)
    evaluate.run(folder, shot, lpips="lpips")
    evaluate.run(folder, shot, lpips="mine.onnx")
    assert asked == ["lpips", "lpips:mine.onnx"]
    assert "LPIPS" in capsys.readouterr().out


def changed(tmp_path, shot, **parts):
    """Write the shot again, with something else in it."""
    return write_shots(tmp_path / "other.h5", [replace(read_shot(shot), **parts)])


def test_the_truth_may_lie_in_another_file_of_the_same_measurement(finished, tmp_path, capsys):
    shot, folder = finished
    other = changed(tmp_path, shot, name="another name", provenance={"from": "elsewhere"})
    assert json.loads(evaluate.run(folder, other).read_text())["notes"] == []
    assert "PSNR" in capsys.readouterr().out


def test_a_shot_of_another_measurement_is_refused_and_nothing_is_written(finished, tmp_path):
    shot, folder = finished
    slope = np.linspace(0, 2, SIZE[0] * SIZE[1] * 3, dtype=np.float32).reshape(*SIZE, 3)
    with pytest.raises(InputError, match=r"of another measurement.*check the file and --index"):
        evaluate.run(folder, changed(tmp_path, shot, measurement=slope))
    assert not (folder / "evaluation.json").exists()


def test_other_masks_or_another_scale_of_the_same_measurement_are_said(finished, tmp_path, capsys):
    shot, folder = finished
    evaluate.run(folder, changed(tmp_path, shot, masks=np.full((VIEWS, *SIZE), 0.5, np.float32)))
    assert "masks are not those of the reconstruction" in capsys.readouterr().out
    evaluate.run(folder, changed(tmp_path, shot, measurement=np.full((*SIZE, 3), 1.5 * VIEWS * 0.5, np.float32)))
    assert "readings are 1.5 times those" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"read_noise": 0.0}, "--read-noise 0"),
        ({"read_noise": float("nan")}, "--read-noise nan"),
        ({"read_noise": 1e300}, r"--read-noise 1e\+300"),
        ({"read_noise": 0.1, "electrons": -1.0}, "--electrons -1"),
        ({"electrons": 1e4}, "--electrons without --read-noise"),
    ],
)
def test_noise_that_cannot_be_is_refused_by_its_option(finished, options, problem):
    shot, folder = finished
    with pytest.raises(InputError, match=problem):
        evaluate.run(folder, shot, **options)


@pytest.mark.parametrize(
    ("rank", "words"), [(0.9, "the true poses contradict the true depth"), (-0.9, "inside out"), (None, "inside out")]
)
def test_a_reversed_path_is_called_so_unless_depth_has_the_true_order(rank, words):
    figures = dict.fromkeys(("scale", "abs_rel", "median_rel", "rms", "close_share", "known_share"), 1.0)
    found = {
        "novel_views": None,
        "lpips": None,
        "trajectory": {"reversed": True},
        "depth": figures | {"rank": rank, "median_px": None, "far_off_share": None},
        "residual": {"rms": 0.1, "chi2_per_pixel": None},
    }
    for depth in (found["depth"], None):
        told = dict(evaluate.rows(found | {"depth": depth}))["order"]
        assert told.startswith(words if depth else "inside out")
