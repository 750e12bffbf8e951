"""Large pictures are rendered a few views at a time, and nobody can tell."""

from dataclasses import fields, replace

import pytest
import torch

from gs2ci.render.cpu import backend as module
from gs2ci.render.cpu.backend import CpuBackend


@pytest.fixture
def case(make):
    return make(views=5)


def rendered(case, colours=None, times=None):
    scene = case.scene if times is None else replace(case.scene, motion=torch.full((len(case.scene), 2, 3), 0.1))
    given = (scene, case.poses, case.intrinsics, case.size)
    with torch.no_grad():
        images = CpuBackend().views(*given, colours=colours, times=times)
    stopped = CpuBackend().depths(*given, times=times)
    return (*images, *(getattr(stopped, field.name) for field in fields(stopped)))


@pytest.mark.parametrize("at_once", [1, 2])
@pytest.mark.parametrize("kind", ["still", "moving", "colours of each view"])
def test_views_in_parts_are_the_same_to_the_last_bit(case, monkeypatch, at_once, kind):
    colours = torch.rand(5, len(case.scene), 3) if kind == "colours of each view" else None
    times = torch.linspace(-1, 1, 5) if kind == "moving" else None
    whole = rendered(case, colours, times)
    sizes = []
    monkeypatch.setattr(module, "MOST_PIXELS_AT_ONCE", at_once * case.size[0] * case.size[1] + 1)
    plain = CpuBackend._full_layout
    monkeypatch.setattr(
        CpuBackend, "_full_layout", lambda self, shape, lens: sizes.append(shape[0]) or plain(self, shape, lens)
    )
    parts = rendered(case, colours, times)
    assert max(sizes) == at_once
    assert all(torch.equal(one, other) for one, other in zip(whole, parts, strict=True))


def test_views_whose_gradient_is_wanted_are_rendered_together(case, monkeypatch):
    monkeypatch.setattr(module, "MOST_PIXELS_AT_ONCE", 1)
    scene = case.scene.map(lambda tensor: tensor.clone().requires_grad_())
    images, alphas = CpuBackend().views(scene, case.poses, case.intrinsics, case.size)
    (images.sum() + alphas.sum()).backward()
    assert scene.colours.grad is not None
    assert scene.colours.grad.abs().sum() > 0


def left_by_an_iteration(case, backend):
    scene = case.scene.map(torch.clone)
    _, pull = backend.coded_with_pull(scene, case.poses, case.intrinsics, backend.code(case.masks))
    pull(torch.ones(*case.size, 3).numpy())
    (workspace,) = backend._pool._idle
    return workspace


@pytest.mark.parametrize("kind", ["views", "depths", "coded sum"])
def test_what_an_iteration_left_is_freed_by_large_renderings_without_a_gradient(case, monkeypatch, kind):
    backend = CpuBackend()
    left = left_by_an_iteration(case, backend)

    def render():
        given = (case.scene, case.poses, case.intrinsics)
        with torch.no_grad():
            if kind == "coded sum":
                backend.coded(*given, backend.code(case.masks))
            else:
                getattr(backend, kind)(*given, case.size)

    render()
    assert left in backend._pool._idle
    monkeypatch.setattr(module, "MOST_PIXELS_AT_ONCE", case.size[0] * case.size[1])
    render()
    assert left not in backend._pool._idle


def test_a_large_coded_sum_whose_gradient_is_wanted_frees_nothing(case, monkeypatch):
    backend = CpuBackend()
    left_by_an_iteration(case, backend)
    monkeypatch.setattr(module, "MOST_PIXELS_AT_ONCE", 1)
    scene = case.scene.map(lambda tensor: tensor.clone().requires_grad_())
    image = backend.coded(scene, case.poses, case.intrinsics, backend.code(case.masks))
    image.sum().backward()
    assert backend.idle_workspaces == 1
