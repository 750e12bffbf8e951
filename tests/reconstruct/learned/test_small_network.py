"""The road from simulated exposures over training and ONNX to a decode, with a network of a few numbers."""

import numpy as np
import pytest
import torch

from gs2ci.reconstruct.learned.onnx_video_decoder import OnnxVideoDecoder
from tests.benchmarks.small_network import SmallNetwork, examples, export, train
from tests.tables.cases import Case


@pytest.fixture(scope="module")
def shots():
    return [Case("planes", scene="planes", size=(24, 32), views=4).shot(seed) for seed in range(2)]


def test_examples_obey_the_measurement_s_equation_but_for_the_camera_s_motion(shots):
    y, masks, total, views = examples(shots, 6, 16, torch.Generator().manual_seed(0))
    assert y.shape == total.shape == (6, 1, 16, 16)
    assert masks.shape == views.shape == (6, 4, 16, 16)
    assert (total > 0).all()
    left = ((masks * views).sum(dim=1, keepdim=True) - y).square().mean().sqrt()
    assert float(left) < 0.1 * float(y.square().mean().sqrt())


def test_a_network_learns_is_exported_and_decodes(shots, tmp_path):
    torch.manual_seed(0)
    network = SmallNetwork(stages=1, width=4)
    errors = train(network, shots, 60, side=16, at_once=2)
    assert np.mean(errors[-15:]) < 0.7 * np.mean(errors[:5])
    decode = OnnxVideoDecoder(export(network, tmp_path / "small.onnx"))
    shot = shots[0]
    masks = torch.from_numpy(shot.masks * shot.weights[:, None, None])[None]
    total = masks.sum(dim=1, keepdim=True)
    y = torch.from_numpy(shot.measurement).permute(2, 0, 1)[:, None]
    with torch.no_grad():
        wanted = [network(one[None], masks, torch.where(total == 0, torch.ones(()), total))[0] for one in y]
    np.testing.assert_allclose(decode(shot), torch.stack(wanted, dim=-1).numpy(), atol=1e-4)
