"""Reading and exporting FFDNet, on small networks that denoise by construction."""

import itertools
import sys

import numpy as np
import pytest
import torch
from torch.nn import functional

from gs2ci.core.errors import InputError, StorageError
from gs2ci.reconstruct.learned.ffdnet import FfdNet, export_ffdnet, read_ffdnet
from gs2ci.reconstruct.learned.onnx_denoiser import OnnxDenoiser
from gs2ci.reconstruct.learned.weight_file import Convolution


def small_weights(channels=1, *, map_first=False, predicts_noise=False, norms=False, seed=0):
    """Weights of three layers that average the four sub-images of each colour, or give what is left of them."""
    subs = 4 * channels
    first = torch.zeros(2 * subs, subs + 1, 3, 3)
    at = 1 if map_first else 0
    for s in range(subs):
        first[s, at + s, 1, 1] = 1  # keeps the image, which is positive
        c = s // 4 * 4
        first[subs + s, at + c : at + c + 4, 1, 1] = 1 / 4  # and its mean over 2 x 2 pixels
    last = torch.zeros(subs, 2 * subs, 3, 3)
    for s in range(subs):
        last[s, subs + s, 1, 1] = -1 if predicts_noise else 1
        if predicts_noise:
            last[s, s, 1, 1] = 1
    middle = torch.zeros(2 * subs, 2 * subs, 3, 3)
    middle[range(2 * subs), range(2 * subs), 1, 1] = 1
    state = {"net.0.weight": first, "net.2.weight": middle}
    if norms:
        generator = torch.Generator().manual_seed(seed)
        gain = 0.5 + torch.rand(2 * subs, generator=generator)
        state |= {
            "net.3.weight": gain,
            "net.3.bias": torch.full((2 * subs,), 0.3),
            "net.3.running_mean": torch.full((2 * subs,), 0.3) / gain,
            "net.3.running_var": torch.ones(2 * subs) - 1e-5,
            "net.3.num_batches_tracked": torch.tensor(7),
        }
        last = last / gain[None, :, None, None]
    return state | {"net.5.weight": last}


@pytest.fixture
def written(tmp_path):
    def write(content):
        torch.save(content, tmp_path / "weights.pth")
        return tmp_path / "weights.pth"

    return write


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("map_first", [False, True])
@pytest.mark.parametrize("predicts_noise", [False, True])
def test_order_and_meaning_are_found_by_trying(written, channels, map_first, predicts_noise):
    network = read_ffdnet(
        written(small_weights(channels, map_first=map_first, predicts_noise=predicts_noise, norms=True))
    )
    assert (network.channels, network.map_first, network.predicts_noise) == (channels, map_first, predicts_noise)
    assert len(network.layers) == 3


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("map_first", [False, True])
@pytest.mark.parametrize("predicts_noise", [False, True])
def test_the_exported_graph_is_the_network(tmp_path, channels, map_first, predicts_noise):
    generator = torch.Generator().manual_seed(0)
    widths = [4 * channels + 1, 6, 5, 4 * channels]
    layers = tuple(
        Convolution(torch.randn(o, i, 3, 3, generator=generator) / 5, torch.randn(o, generator=generator) / 5)
        for i, o in itertools.pairwise(widths)
    )
    network = FfdNet(layers, map_first, predicts_noise)
    images = torch.rand(2, channels, 16, 24, generator=generator)
    with torch.no_grad():
        expected = network(images, torch.tensor([0.2, 0.2])).numpy()
    denoise = OnnxDenoiser(export_ffdnet(network, tmp_path / "deep" / "small.onnx"))
    np.testing.assert_allclose(denoise(images.numpy(), 0.2), expected, atol=1e-5)
    assert denoise(images.numpy()[:, :, :15, :21], 0.2).shape == (2, channels, 15, 21)


def test_batch_normalisations_fold_into_the_convolutions_before_them(written):
    state = small_weights(norms=True)
    network = read_ffdnet(written(state))
    image = torch.rand(1, 1, 12, 12)
    x = torch.cat([functional.pixel_unshuffle(image, 2), torch.full((1, 1, 6, 6), 0.1)], 1)
    x = functional.conv2d(x, state["net.0.weight"], padding=1).relu()
    x = functional.conv2d(x, state["net.2.weight"], padding=1)
    norm = [state[f"net.3.{name}"] for name in ("running_mean", "running_var", "weight", "bias")]
    x = functional.conv2d(functional.batch_norm(x, *norm).relu(), state["net.5.weight"], padding=1)
    torch.testing.assert_close(network(image, torch.tensor([0.1])), functional.pixel_shuffle(x, 2))


@pytest.mark.parametrize("key", ["state_dict", "params"])
def test_weights_beside_other_things_are_found(written, key):
    assert read_ffdnet(written({key: small_weights(), "epoch": 3})).channels == 1


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match="no weight file"):
        read_ffdnet(tmp_path / "absent.pth")


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"", "it is empty"),
        (b"plain text, no weights", "it begins with 'plain text, no weights'"),
        (b"\xff\xd8\xff\xe0 a picture", "it begins with bytes ff d8 ff e0"),
        (b"PK\x03\x04 cut short", "it is damaged, or holds more than tensors"),
    ],
)
def test_a_file_that_is_no_weight_file_is_named_with_what_was_found_and_what_is_wanted(tmp_path, content, found):
    (tmp_path / "weights.pth").write_bytes(content)
    with pytest.raises(InputError, match=f"is not a PyTorch weight file: {found}") as caught:
        read_ffdnet(tmp_path / "weights.pth")
    assert "torch.save" in caught.value.allowed


class Hostile:
    def __reduce__(self):
        return (print, ("run",))


def test_code_in_a_weight_file_is_not_run(written, capsys):
    with pytest.raises(InputError, match="is not a PyTorch weight file"):
        read_ffdnet(written({"net.0.weight": Hostile()}))
    assert "run" not in capsys.readouterr().out


@pytest.mark.parametrize("content", [[1, 2], {"epoch": 3}, torch.zeros(3)])
def test_other_contents_are_no_state_dictionary(written, content):
    with pytest.raises(InputError, match="holds no state dictionary"):
        read_ffdnet(written(content))


@pytest.mark.parametrize(
    "damage", ["one layer", "wrong input", "not chained", "five by five", "stray tensor", "nothing"]
)
def test_other_layers_are_no_ffdnet(written, damage):
    state = small_weights()
    if damage == "one layer":
        state = {"net.0.weight": torch.zeros(4, 5, 3, 3)}
    elif damage == "wrong input":
        state["net.0.weight"] = torch.zeros(8, 7, 3, 3)
    elif damage == "not chained":
        state["net.2.weight"] = torch.zeros(8, 9, 3, 3)
    elif damage == "five by five":
        state["net.2.weight"] = torch.zeros(8, 8, 5, 5)
    elif damage == "stray tensor":
        state["net.1.weight"] = torch.zeros(8)
    else:
        state = {}
    with pytest.raises(InputError, match="does not hold the layers of an FFDNet"):
        read_ffdnet(written(state))


@pytest.mark.parametrize("value", [0.0, 0.5, float("nan")])
def test_weights_that_do_not_denoise_are_refused(written, value):
    state = {name: torch.full_like(tensor, value) for name, tensor in small_weights().items()}
    with pytest.raises(InputError, match="do not denoise"):
        read_ffdnet(written(state))


def test_without_the_package_onnx_the_error_says_what_to_install(written, tmp_path, monkeypatch):
    network = read_ffdnet(written(small_weights()))
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(InputError) as caught:
        export_ffdnet(network, tmp_path / "small.onnx")
    assert "gs2ci[export]" in caught.value.remedy
    assert not (tmp_path / "small.onnx").exists()


def test_a_place_that_cannot_be_written_is_named(written, tmp_path):
    network = read_ffdnet(written(small_weights()))
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(StorageError, match="cannot be written"):
        export_ffdnet(network, tmp_path / "file" / "small.onnx")
    (tmp_path / "folder.onnx").mkdir()
    with pytest.raises(StorageError, match="cannot be written"):
        export_ffdnet(network, tmp_path / "folder.onnx")
    assert not list(tmp_path.glob(".*partial"))
