"""The export from a package of the authors' interface: small networks stand in for theirs."""

import sys
from types import ModuleType

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError, NumericsError, StorageError
from gs2ci.reconstruct.learned import vggt_export
from gs2ci.reconstruct.learned.vggt import Vggt
from gs2ci.reconstruct.learned.vggt_export import export_vggt, load_vggt


class Small(torch.nn.Module):
    """VGGT's interface: aggregator, camera head and depth head."""

    def __init__(self, rigid=False):
        super().__init__()
        self.features = torch.nn.Conv2d(3, 4, 14, stride=14)
        self.pose = torch.nn.Linear(4, 9)
        self.rigid = rigid

    def aggregator(self, images):
        batch, views = images.shape[:2]
        grid = self.features(images.flatten(0, 1))
        return [grid.flatten(2).mean(2).reshape(batch, int(views) if self.rigid else views, 4)], 0

    def camera_head(self, tokens):
        pose = self.pose(tokens[-1])
        return [pose * 0, torch.cat([pose[..., :7], pose[..., 7:].sigmoid() + 0.2], dim=-1)]

    def depth_head(self, tokens, images, patches_from):
        depth = images.mean(2)[..., None] + 1
        return depth, depth[..., 0]


@pytest.fixture
def network():
    torch.manual_seed(0)
    return Small().eval()


@pytest.fixture
def package(monkeypatch):
    module = ModuleType("vggt.models.vggt")
    module.VGGT = Small
    for name in ("vggt", "vggt.models"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, "vggt.models.vggt", module)


def test_the_file_answers_as_the_network_for_any_number_of_views(network, tmp_path):
    path = export_vggt(network, tmp_path / "new" / "vggt.onnx", views=3, side=28)
    assert [file.name for file in path.parent.iterdir()] == ["vggt.onnx"]
    views = np.random.default_rng(0).random((6, 28, 28, 3)).astype(np.float32)
    found = Vggt(path).predict(views, range(6))
    with torch.no_grad():
        tokens, _ = network.aggregator(torch.from_numpy(views).permute(0, 3, 1, 2)[None])
        pose = network.camera_head(tokens)[-1][0].numpy()
    np.testing.assert_allclose(found.world_to_camera[:, :3, 3], pose[:, :3], atol=1e-5)
    np.testing.assert_allclose(found.depth, views.mean(3) + 1, atol=1e-5)
    assert Vggt(path).taken == "any number of views"


def test_a_network_that_traces_for_one_number_of_views_says_so(tmp_path):
    torch.manual_seed(0)
    path = export_vggt(Small(rigid=True).eval(), tmp_path / "vggt.onnx", views=3, side=28)
    assert Vggt(path).taken == "exactly 3 views"


def test_large_weights_lie_in_a_file_beside_it(network, tmp_path, monkeypatch):
    monkeypatch.setattr(vggt_export, "_ONE_FILE_BYTES", 0)
    wide = network
    wide.features.weight = torch.nn.Parameter(torch.rand(4, 3, 14, 14))
    path = export_vggt(wide, tmp_path / "vggt.onnx", views=2, side=28)
    assert {file.name for file in tmp_path.iterdir()} == {"vggt.onnx", "vggt.onnx.data"}
    assert np.isfinite(Vggt(path).predict(np.zeros((2, 28, 28, 3), np.float32), range(2)).depth).all()


def test_a_file_that_answers_otherwise_is_not_kept(network, tmp_path, monkeypatch):
    monkeypatch.setattr(vggt_export, "_agrees", lambda *given: False)
    with pytest.raises(NumericsError, match="output differs"):
        export_vggt(network, tmp_path / "vggt.onnx", views=2, side=28)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("views", "side"), [(1, 28), (2, 0), (2, 30)])
def test_numbers_out_of_range_are_refused(network, tmp_path, views, side):
    with pytest.raises(InputError, match="views of"):
        export_vggt(network, tmp_path / "vggt.onnx", views=views, side=side)


def test_a_place_that_cannot_be_written_and_a_missing_package_are_named(network, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot be written"):
        export_vggt(network, tmp_path / "file" / "vggt.onnx", views=2, side=28)
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(InputError, match="needs the package onnx"):
        export_vggt(network, tmp_path / "vggt.onnx", views=2, side=28)


@pytest.mark.usefixtures("package")
def test_weights_are_filled_into_the_authors_network(network, tmp_path):
    torch.save(network.state_dict(), tmp_path / "model.pt")
    loaded = load_vggt(tmp_path / "model.pt")
    torch.testing.assert_close(loaded.pose.weight, network.pose.weight)
    assert not loaded.training


@pytest.mark.usefixtures("package")
def test_weights_of_another_network_or_none_are_named(tmp_path):
    with pytest.raises(InputError, match="no weight file"):
        load_vggt(tmp_path / "absent.pt")
    torch.save({"other": torch.zeros(3)}, tmp_path / "other.pt")
    with pytest.raises(InputError, match="does not hold VGGT's weights"):
        load_vggt(tmp_path / "other.pt")
    (tmp_path / "notes.pt").write_bytes(b"no weights")
    with pytest.raises(InputError, match="does not hold VGGT's weights"):
        load_vggt(tmp_path / "notes.pt")


def test_without_the_authors_package_it_says_what_to_install(tmp_path):
    with pytest.raises(InputError, match="needs the package vggt"):
        load_vggt(tmp_path / "model.pt")
