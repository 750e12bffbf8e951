"""Coded renderings that are differentiated by a call are those of torch's graph."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.render.adjoint import accumulate, coded_with_pull, pull_back
from gs2ci.render.cpu.backend import CpuBackend
from gs2ci.render.screen import ScreenStatistics
from gs2ci.render.settings import RasterSettings
from tests.render.backends import BACKENDS, load_backend


def with_graph(backend, case, weights, times=None):
    scene, poses = case.scene.map(lambda tensor: tensor.clone().requires_grad_()), case.poses.clone().requires_grad_()
    image = backend.coded(scene, poses, case.intrinsics, backend.code(case.masks), times=times)
    image.backward(weights.to(image.dtype))
    return image.detach(), {**{name: tensor.grad for name, tensor in scene.parameters().items()}, "poses": poses.grad}


def by_call(backend, case, weights, times=None, screen=None, reuse=None):
    scene = case.scene.map(lambda tensor: tensor.clone().requires_grad_())
    coding = backend.code(case.masks)
    image, pull = coded_with_pull(backend, scene, case.poses, case.intrinsics, coding, screen, reuse, times)
    by_poses = torch.from_numpy(pull(weights.numpy()))
    return torch.from_numpy(image), {**{name: t.grad for name, t in scene.parameters().items()}, "poses": by_poses}


@pytest.fixture
def weights():
    return torch.randn(19, 23, 3, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("how", ["plain", "lists kept", "moving", "harmonics"])
@pytest.mark.parametrize("name", BACKENDS)
def test_image_and_gradients_are_those_of_the_graph(make, weights, how, name):
    case, times = make(count=40), None
    backend = load_backend(name)
    if how == "moving":
        case = replace(case, scene=replace(case.scene, motion=torch.full((40, 1, 3), 0.05)))
        times = torch.tensor([-1.0, 0.0, 1.0])
    if how == "harmonics":
        case = replace(case, scene=replace(case.scene, harmonics=torch.full((40, 3, 3), 0.1)))
    reuse = None
    if how == "lists kept":
        backend = load_backend(name, RasterSettings(relist_every=3))
        reuse = backend.reuse()
    image, gradients = by_call(backend, case, weights, times, reuse=reuse)
    expected, wanted = with_graph(backend, case, weights, times)
    assert torch.equal(image, expected.float())
    assert set(gradients) == set(wanted)
    for field, gradient in gradients.items():
        torch.testing.assert_close(gradient, wanted[field].to(gradient.dtype), rtol=1e-6, atol=1e-7, msg=field)


def test_gradients_are_added_and_the_screen_is_recorded(make, weights):
    case, backend, screen = make(), CpuBackend(), ScreenStatistics.empty(40)
    _, once = by_call(backend, case, weights, screen=screen)
    assert screen.sightings.max() == 3
    scene = case.scene.map(torch.clone)
    for _ in range(2):
        _, pull = coded_with_pull(backend, scene, case.poses, case.intrinsics, backend.code(case.masks))
        pull(weights.numpy())
    torch.testing.assert_close(scene.means.grad, 2 * once["means"])
    accumulate(scene, {"colours": np.ones((40, 3), np.float32)})
    torch.testing.assert_close(scene.colours.grad, 2 * once["colours"] + 1)


def test_a_rendering_is_differentiated_once(make, weights):
    case, backend = make(), CpuBackend()
    _, pull = coded_with_pull(backend, case.scene, case.poses, case.intrinsics, backend.code(case.masks))
    pull(weights.numpy())
    assert backend.idle_workspaces == 1
    with pytest.raises(RuntimeError, match="differentiated twice"):
        pull(weights.numpy())


def test_gradients_are_pulled_back_to_the_bit_as_torch_does():
    draw = torch.Generator().manual_seed(0)
    start, *gradients = (torch.randn(200, 3, generator=draw) for _ in range(3))

    def by(backward):
        leaf = start.clone().requires_grad_()
        backward([leaf.exp(), (leaf.double() @ start.T.double()).float() @ start], gradients)
        return leaf.grad

    assert torch.equal(by(pull_back), by(torch.autograd.backward))
