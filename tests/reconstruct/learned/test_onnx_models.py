import json

import numpy as np
import pytest

from gs2ci.core.errors import InputError, NumericsError, StorageError
from gs2ci.reconstruct.learned.onnx_models import add_model, find_model, known_model, open_model, run_model

IMAGE = [("image", ("n", 3, "h", "w"))]


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("GS2CI_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


@pytest.fixture
def model(write_model):
    return write_model([("Relu", ["image"], ["out"])], IMAGE, [("out", ("n", 3, "h", "w"))])


def test_a_model_that_was_added_is_found_with_its_sum(home, model):
    added = add_model("difix", model)
    assert find_model("difix") == model.resolve()
    assert known_model("difix") == added
    assert len(added.sha256) == 64
    assert json.loads((home / "models.json").read_text())["difix"]["sha256"] == added.sha256


def test_adding_again_replaces_one_name_and_leaves_the_others(home, model, tmp_path):
    other = tmp_path / "other.onnx"
    other.write_bytes(b"another file")
    add_model("difix", model)
    add_model("vggt", model)
    add_model("difix", other)
    assert find_model("difix") == other
    assert find_model("vggt") == model
    assert [path.name for path in home.iterdir()] == ["models.json"]


@pytest.mark.usefixtures("home")
def test_a_name_without_a_model_says_how_to_add_one():
    assert known_model("vggt") is None
    with pytest.raises(InputError, match="no vggt model") as caught:
        find_model("vggt")
    assert "gs2ci models add vggt FILE" in caught.value.remedy


@pytest.mark.usefixtures("home")
def test_a_file_that_is_not_there_cannot_be_added(tmp_path):
    with pytest.raises(InputError, match="no model file"):
        add_model("vggt", tmp_path / "absent.onnx")
    assert known_model("vggt") is None


@pytest.mark.usefixtures("home")
def test_a_model_that_has_changed_or_gone_is_refused(model):
    add_model("vggt", model)
    model.write_bytes(b"something else")
    with pytest.raises(InputError, match="content has changed"):
        find_model("vggt")
    model.unlink()
    with pytest.raises(InputError, match="is gone"):
        find_model("vggt")


@pytest.mark.parametrize("text", ["not json", '{"vggt": {"path": "x"}}', '{"vggt": 3}'])
def test_a_damaged_list_is_named(home, text):
    home.mkdir()
    (home / "models.json").write_text(text)
    with pytest.raises(StorageError, match=r"models\.json"):
        find_model("vggt")


def test_a_list_that_cannot_be_written_is_named(home, model):
    home.write_text("a file where a folder should be")
    with pytest.raises(StorageError, match="cannot be written"):
        add_model("vggt", model)


def test_without_a_home_of_its_own_the_list_lies_in_the_users_configuration(monkeypatch, tmp_path, model):
    monkeypatch.delenv("GS2CI_HOME", raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    add_model("lpips", model)
    assert (tmp_path / "config" / "gs2ci" / "models.json").is_file()


def test_a_model_runs_and_its_outputs_come_by_name(model):
    image = np.full((2, 3, 4, 5), -1, np.float32)
    answer = run_model(open_model(model, "-"), "small", {"image": image}, "-")
    assert answer.keys() == {"out"}
    assert not answer["out"].any()


def test_a_file_that_is_missing_or_no_model_or_too_new_is_named(tmp_path, write_model):
    with pytest.raises(InputError, match="no model file") as caught:
        open_model(tmp_path / "absent.onnx", "export one")
    assert caught.value.remedy == "export one"
    (tmp_path / "notes.onnx").write_text("no model")
    with pytest.raises(InputError, match="cannot be loaded"):
        open_model(tmp_path / "notes.onnx", "-")
    with pytest.raises(InputError, match="cannot be loaded"):
        open_model(write_model([("Relu", ["image"], ["out"])], IMAGE, [("out", ("n",))], opset=999), "-")


def test_a_model_that_fails_is_named_with_what_it_was_given(model):
    with pytest.raises(NumericsError, match=r"small failed on image \[1, 2, 4, 4\]"):
        run_model(open_model(model, "-"), "small", {"image": np.zeros((1, 2, 4, 4), np.float32)}, "-")
