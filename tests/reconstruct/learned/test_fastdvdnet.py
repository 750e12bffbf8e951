"""Reading and exporting FastDVDnet, on small networks with random weights."""

import sys

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.learned.fastdvdnet import export_fastdvdnet, read_fastdvdnet
from gs2ci.reconstruct.learned.onnx_video_denoiser import OnnxVideoDenoiser
from tests.reconstruct.learned.fastdvdnet_weights import LAYERS, small_state


def unet_reference(state, step, frames, level):
    """Pass the layers one after the other as the paper's figure shows them, without folding anything."""

    def stage(name, x):
        for place, *_, norm in LAYERS:
            if not place.startswith(name + "."):
                continue
            first = place.endswith("convblock.0") and place.count("convblock") == 1
            head, number = place.rsplit(".", 1)
            x = torch.nn.functional.conv2d(
                x,
                state[f"module.{step}.{place}.weight"],
                padding=1,
                stride=2 if first and name.startswith("down") else 1,
                groups=3 if first and name == "inc" else 1,
            )
            if norm:
                after = f"module.{step}.{head}.{int(number) + 1}"
                mean, variance = state[f"{after}.running_mean"], state[f"{after}.running_var"]
                x = torch.nn.functional.batch_norm(x, mean, variance, state[f"{after}.weight"], state[f"{after}.bias"])
                x = x.relu()
        return x

    x0 = stage("inc", torch.cat([part for frame in frames for part in (frame, level)], 1))
    x1 = stage("downc0", x0)
    x2 = torch.pixel_shuffle(stage("upc2", stage("downc1", x1)), 2)
    x1 = torch.pixel_shuffle(stage("upc1", x1 + x2), 2)
    return frames[1] - stage("outc", x0 + x1)


@pytest.fixture
def written(tmp_path):
    def write(state):
        torch.save(state, tmp_path / "weights.pth")
        return tmp_path / "weights.pth"

    return write


def test_the_network_and_its_export_are_those_of_the_paper(written, tmp_path):
    state = small_state()
    network = read_fastdvdnet(written(state))
    frames, sigma = torch.rand(1, 5, 3, 16, 24, generator=torch.Generator().manual_seed(1)), torch.tensor([0.1])
    level = torch.full((1, 1, 16, 24), 0.1)
    parts = list(frames.unbind(1))
    middle = [unet_reference(state, "temp1", parts[i : i + 3], level) for i in range(3)]
    expected = unet_reference(state, "temp2", middle, level).numpy()
    scale = np.abs(expected).max()
    np.testing.assert_allclose(network(frames, sigma).numpy(), expected, atol=1e-4 * scale)
    session = OnnxVideoDenoiser(export_fastdvdnet(network, tmp_path / "small.onnx"))._session
    (answer,) = session.run(None, {"frames": frames.numpy(), "sigma": sigma.numpy()})
    np.testing.assert_allclose(answer, expected, atol=1e-4 * scale)


def without(state, end):
    return {name: value for name, value in state.items() if not name.endswith(end)}


@pytest.mark.parametrize(
    "spoil",
    [
        lambda state: without(state, "temp2.outc.convblock.3.weight"),
        lambda state: without(state, "temp1.upc1.convblock.1.weight"),
        lambda state: without(state, "temp1.inc.convblock.1.running_var"),
        lambda state: state | {"module.temp1.upc2.convblock.1.weight": torch.zeros(25, 8, 3, 3)},
        lambda state: state | {"module.temp1.downc0.convblock.0.weight": torch.zeros(6, 5, 3, 3)},
        lambda state: {"net.0.weight": torch.zeros(4, 5, 3, 3)},
    ],
)
def test_other_layers_are_refused(written, spoil):
    with pytest.raises(InputError, match="does not hold the layers of FastDVDnet"):
        read_fastdvdnet(written(spoil(small_state())))


def test_a_missing_weight_file_is_named(tmp_path):
    with pytest.raises(InputError, match="no weight file"):
        read_fastdvdnet(tmp_path / "absent.pth")


def test_without_onnx_the_export_says_what_to_install(written, tmp_path, monkeypatch):
    network = read_fastdvdnet(written(small_state()))
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(InputError, match="needs the package onnx"):
        export_fastdvdnet(network, tmp_path / "small.onnx")
