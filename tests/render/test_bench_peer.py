"""The torch rasteriser that `make benchmarks` compares with must solve the same problem to be a fair peer."""

import torch

from tests.benchmarks.torch_rasteriser import coded_sum
from tests.render.backends import load_backend


def test_peer_of_the_benchmark_agrees_with_the_definition(make, with_margin):
    case = with_margin(lambda seed: make(seed, size=(21, 17)))
    scenes = [case.scene.map(lambda t: t.clone().requires_grad_()) for _ in range(2)]
    reference = load_backend("reference")
    truth = reference.coded(scenes[0], case.poses, case.intrinsics, reference.code(case.masks))
    peer = coded_sum(scenes[1], case.poses, case.intrinsics, case.masks)
    torch.testing.assert_close(peer.double(), truth, rtol=1e-4, atol=1e-5)
    truth.square().sum().backward()
    peer.square().sum().backward()
    for name, expected in scenes[0].parameters().items():
        gradient = scenes[1].parameters()[name].grad
        assert (gradient - expected.grad).norm() <= 1e-3 * expected.grad.norm(), name
