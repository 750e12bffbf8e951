import pytest
import torch
import tyro

from gs2ci.commands.models import run
from gs2ci.core.errors import InputError
from gs2ci.reconstruct.decode.onnx_denoiser import OnnxDenoiser


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


def test_an_earlier_model_stays_unless_it_is_to_be_replaced(tmp_path, weights):
    path = tmp_path / "ffdnet.onnx"
    path.write_text("mine")
    with pytest.raises(InputError, match="exists"):
        run("export-ffdnet", weights, output=path)
    assert path.read_text() == "mine"
    run("export-ffdnet", weights, output=path, overwrite=True)
    OnnxDenoiser(path)


def test_weights_that_cannot_be_used_write_nothing(tmp_path):
    with pytest.raises(InputError, match="no weight file"):
        run("export-ffdnet", tmp_path / "absent.pth", output=tmp_path / "ffdnet.onnx")
    assert not list(tmp_path.iterdir())
