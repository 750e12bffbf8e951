"""The decode command: its arguments, what it prints, what it writes, and that errors write nothing."""

import json
from pathlib import Path

import numpy as np
import pytest
import tyro
from onnx import TensorProto, helper, save

import gs2ci
from gs2ci.commands.decode import run
from gs2ci.core.errors import InputError, NumericsError, StorageError
from gs2ci.core.records import Shot, Truth
from gs2ci.core.storage import write_shots
from gs2ci.reconstruct.learned.onnx_models import add_model


def make_shots(count, channels=1, *, truth=True, share=0.4):
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:32, :40] / 6
    masks = (rng.random((4, 32, 40)) < share).astype(np.float32)
    for i in range(count):
        views = 0.5 + 0.4 * np.sin(x + 0.2 * np.arange(4)[:, None, None] + i) * np.cos(y)
        views = np.repeat(views[..., None], channels, axis=3).astype(np.float32)
        measured = (masks[..., None] * views).sum(axis=0)
        yield Shot(measured, masks, np.ones(4, np.float32), truth=Truth(views if truth else None), name="waves")


@pytest.fixture
def file(tmp_path):
    return write_shots(tmp_path / "shot.h5", list(make_shots(2)))


@pytest.fixture
def model(tmp_path):
    def make(operator):
        shape = ["n", 1, "h", "w"]
        image, out = (helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in ("a", "b"))
        graph = helper.make_graph([helper.make_node(operator, ["a"], ["b"])], "model", [image], [out])
        proto = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
        proto.ir_version = 8
        save(proto, tmp_path / "model.onnx")
        return f"onnx:{tmp_path / 'model.onnx'}"

    return make


def command(*words):
    folder = tyro.cli(run, args=[str(word) for word in words])
    return json.loads((folder / "report.json").read_text()), np.load(folder / "views.npy")


def test_gap_tv_is_the_default_and_its_score_is_printed(tmp_path, file, capsys):
    report, views = command(file, "-o", tmp_path / "out")
    printed = capsys.readouterr().out
    assert views.shape == (4, 32, 40, 1)
    method = report["shots"][0]["method"]
    assert (method["name"], method["iterations"], method["weight"]) == ("gap-tv", 40, 0.3)
    assert method["clamped"]
    assert f"PSNR {report['psnr_db']:.2f} dB" in printed
    assert "4 views from 1 exposure by gap-tv" in printed
    assert report["psnr_db"] > 20
    assert len(list((tmp_path / "out" / "views").iterdir())) == 4


def test_all_shots_come_in_order_and_one_by_its_index(tmp_path, file):
    _, together = command(file, "-o", tmp_path / "all", "--all", "--coupling", 0.3)
    assert together.shape == (8, 32, 40, 1)
    report, second = command(file, "-o", tmp_path / "one", "--index", 1, "--coupling", 0.3)
    assert np.array_equal(second, together[4:])
    assert report["shots"][0]["method"]["coupling"] == 0.3


def test_a_budget_makes_as_many_steps_as_fit_and_says_how_many(tmp_path, file, monkeypatch, capsys):
    report, _ = command(file, "-o", tmp_path / "out", "--method", "patches", "--budget", "10min", "--all")
    assert [shot["method"]["iterations"] for shot in report["shots"]] == [144, 144]
    assert report["psnr_db"] > 35
    assert "144 steps" in capsys.readouterr().out
    # The user has been waiting for an hour when the first exposure begins; the second has its own ten minutes.
    monkeypatch.setattr("gs2ci.api.decoding.command_age_s", lambda: 3600.0)
    report, _ = command(file, "-o", tmp_path / "late", "--method", "patches", "--budget", "10min", "--all")
    assert [shot["method"]["iterations"] for shot in report["shots"]] == [0, 144]
    assert "spent before the first step" in report["shots"][0]["notes"][-1]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--method", "gap-tv", "--budget", "5s"), "--budget with --method gap-tv"),
        (("--method", "patches", "--budget", "5s", "--iterations", 9), "both --budget and --iterations"),
        (("--method", "patches", "--budget", "soon"), "'soon' is no duration"),
    ],
)
def test_a_budget_that_nothing_can_keep_to_is_refused(tmp_path, file, words, said):
    with pytest.raises(InputError, match=said):
        command(file, "-o", tmp_path / "out", *words)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("method", ["patches", "patches-quick"])
def test_patches_are_decoded_and_said(tmp_path, file, method):
    report, _ = command(file, "-o", tmp_path / "out", "--method", method, "--iterations", 12)
    said = report["shots"][0]["method"]
    assert (said["name"], said["iterations"], said["lattice"]["patch_px"]) == (method, 12, 6)
    assert report["psnr_db"] > 35


@pytest.mark.parametrize("denoiser", [None, "tv", "onnx"])
def test_plug_and_play_takes_any_denoiser(tmp_path, file, model, denoiser):
    name = model("Relu") if denoiser == "onnx" else denoiser
    words = [] if name is None else ["--denoiser", name]
    report, views = command(file, "-o", tmp_path / "out", "--method", "pnp-gap", "--iterations", 2, *words)
    said = report["shots"][0]["method"]
    assert (said["name"], said["iterations"]) == ("pnp-gap", 2)
    assert said["denoiser"] == ("onnx:model.onnx" if denoiser == "onnx" else denoiser or "tv")
    assert np.isfinite(views).all()


def test_a_denoiser_that_was_added_is_found_by_its_name(tmp_path, file, model, monkeypatch):
    monkeypatch.setenv("GS2CI_HOME", str(tmp_path / "home"))
    add_model("ffdnet", Path(model("Relu").removeprefix("onnx:")))
    words = ["--method", "pnp-gap", "--iterations", 2, "--denoiser", "ffdnet"]
    report, _ = command(file, "-o", tmp_path / "out", *words)
    assert report["shots"][0]["method"]["denoiser"] == "ffdnet"
    with pytest.raises(InputError, match="no fastdvdnet model"):
        command(file, "-o", tmp_path / "other", *words[:-1], "fastdvdnet")


@pytest.mark.parametrize(("share", "chosen"), [(0.4, "eni"), (1.0, "eni")])
def test_proxies_say_which_they_are(tmp_path, share, chosen, capsys):
    file = write_shots(tmp_path / "shot.h5", list(make_shots(1, channels=3, truth=False, share=share)))
    report, views = command(file, "-o", tmp_path / "out", "--method", "proxies")
    assert report["shots"][0]["method"]["name"] == chosen
    assert views.shape == (4, 32, 40, 3)
    assert report["psnr_db"] is None
    assert ("do not distinguish their views" in capsys.readouterr().out) == (share == 1.0)


@pytest.mark.parametrize("method", ["eni", "amdi"])
def test_a_proxy_may_be_asked_for_by_name(tmp_path, file, method):
    report, _ = command(file, "-o", tmp_path / "out", "--method", method)
    assert report["shots"][0]["method"]["name"] == method


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (["--denoiser", "tv"], "--denoiser with --method gap-tv"),
        (["--method", "pnp-gap", "--denoiser", "bm3d"], "denoiser 'bm3d'"),
        (["--method", "pnp-gap", "--denoiser", "onnx:absent.onnx"], "no model file"),
        (["--method", "pnp-gap", "--coupling", "0.1"], "--coupling with --method pnp-gap"),
        (["--method", "patches", "--coupling", "0.1"], "--coupling with --method patches"),
        (["--method", "eni", "--iterations", "3"], "--iterations with --method eni"),
        (["--iterations", "0"], "--iterations 0"),
        (["--coupling", "-1"], "--coupling -1"),
        (["--coupling", "nan"], "--coupling nan"),
        (["--method", "pnp-gap", "--iterations", "0"], "--iterations 0"),
        (["--all", "--index", "1"], "both --all and --index 1"),
        (["--seed", "-1"], "--seed -1"),
    ],
)
def test_contradictions_are_refused_before_any_work(tmp_path, file, words, problem):
    with pytest.raises(InputError) as caught:
        command(file, "-o", tmp_path / "out", *words)
    assert problem in caught.value.problem
    assert not (tmp_path / "out").exists()


def test_a_shot_that_the_file_lacks_is_named(tmp_path, file):
    with pytest.raises(StorageError, match="no shot 2"):
        command(file, "-o", tmp_path / "out", "--index", 2)


def test_a_model_that_answers_nan_leaves_nothing_behind(tmp_path, file, model):
    with pytest.raises(NumericsError, match="not finite"):
        command(file, "-o", tmp_path / "out", "--method", "pnp-gap", "--denoiser", model("Log"))
    assert not (tmp_path / "out").exists()


def test_an_earlier_decode_stays_unless_it_is_to_be_replaced(tmp_path, file):
    command(file, "-o", tmp_path / "out", "--method", "eni")
    with pytest.raises(StorageError, match="not empty"):
        command(file, "-o", tmp_path / "out")
    report, _ = command(file, "-o", tmp_path / "out", "--overwrite", "--iterations", 3)
    assert report["shots"][0]["method"]["name"] == "gap-tv"


def test_hot_pixels_and_dead_lines_are_left_out_and_named():
    rng = np.random.default_rng(0)
    masks = (rng.random((4, 32, 40)) < 0.5).astype(np.float32)
    truth = np.broadcast_to(np.linspace(0.2, 0.8, 40, dtype=np.float32)[None, None, :, None], (4, 32, 40, 1))
    measured = (masks[..., None] * truth).sum(axis=0)
    measured[10] = 0
    measured[20, ::9] = 50
    decoded = gs2ci.decode(gs2ci.Shot(measured, masks), registration="off", progress=gs2ci.Silent())
    assert np.abs(decoded.views - truth).max() < 0.1
    unopened, dead, hot = decoded.notes
    assert "No mask opens 87 of 1280 pixels" in unopened
    assert "dead" in dead
    assert "hot" in hot


def test_what_the_measurement_does_not_contain_is_said():
    rng = np.random.default_rng(0)
    masks = (rng.random((4, 32, 40)) < 0.5).astype(np.float32)
    masks[0], masks[2] = masks[:2].max(axis=0) < 0.5, 0
    measured = masks.sum(axis=0)[..., None] * np.linspace(0.2, 0.8, 40, dtype=np.float32)[None, :, None]
    decoded = gs2ci.decode(gs2ci.Shot(measured, masks), registration="off", progress=gs2ci.Silent())
    assert any("No light reached views [2]" in note for note in decoded.notes)
