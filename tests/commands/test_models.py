import hashlib

import pytest
import tyro
from onnx import TensorProto, helper, save

from gs2ci.api import models as models_api
from gs2ci.commands.models import run
from gs2ci.core.errors import InputError


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("GS2CI_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


def written(path, shape):
    """Write a model that negates images."""
    value = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in ("image", "out")]
    graph = helper.make_graph([helper.make_node("Neg", ["image"], ["out"])], "negation", value[:1], value[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    save(model, path)
    return path


@pytest.fixture
def negation(tmp_path):
    """An image-to-image model."""
    return written(tmp_path / "negation.onnx", (1, 3, "h", "w"))


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


@pytest.mark.parametrize("call", [("add", "difix"), ("list", "difix")])
def test_too_few_or_too_many_arguments_are_answered_with_the_call(call):
    with pytest.raises(InputError, match="arguments") as caught:
        run(call[0], call[1:])
    assert f"gs2ci models {call[0]}" in caught.value.allowed


def test_a_name_that_is_not_known_is_refused(negation):
    with pytest.raises(InputError, match="model name 'dust3r'"):
        run("add", ("dust3r", negation))


def test_a_grey_denoiser_does_not_get_the_name_of_a_coloured_one(home, tmp_path):
    grey = written(tmp_path / "grey.onnx", ("n", 1, "h", "w"))
    with pytest.raises(InputError, match="is a grey denoiser") as caught:
        run("add", ("ffdnet-colour", grey))
    assert "under the name ffdnet" in caught.value.remedy
    assert models_api.list_models() == []
    run("add", ("ffdnet", grey))
    assert [model.name for model in models_api.list_models()] == ["ffdnet"]
