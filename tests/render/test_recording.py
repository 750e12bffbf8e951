"""Launches that are called first, captured when they are due again, and replayed from then on."""

import numpy as np
import pytest
import torch

pytest.importorskip("warp", reason="Warp is not installed")

import warp as wp

from gs2ci.render import places, recording
from gs2ci.render.recording import Launcher, Recording
from gs2ci.render.settings import RasterSettings
from gs2ci.render.warp.backend import WarpBackend


@wp.kernel
def doubled(numbers: wp.array(dtype=wp.float32)):
    at = wp.tid()
    numbers[at] = 2.0 * numbers[at]


@pytest.fixture
def device():
    """Let the host be a device, whose launches are captured."""
    places.count_host_as_device(yes=True)
    yield
    places.count_host_as_device(yes=False)


@pytest.fixture
def doubling():
    wp.init()
    numbers, calls = wp.ones(5, dtype=wp.float32, device="cpu"), []

    def launches(launch: Launcher) -> None:
        calls.append(launch)
        launch(doubled, 5, [numbers], [])

    return Recording("cpu", launches), numbers, calls


def test_a_function_is_called_once_captured_once_and_replayed(doubling, device):
    recorded, numbers, calls = doubling
    for turn in range(1, 6):
        recorded.run()
        np.testing.assert_array_equal(numbers.numpy(), 2.0**turn)
    assert len(calls) == 2
    assert recorded.replays


def test_it_is_called_again_after_its_arrays_have_moved(doubling, device):
    recorded, numbers, calls = doubling
    for _ in range(3):
        recorded.run()
    recorded.forget()
    recorded.run()
    assert (len(calls), numbers.numpy()[0]) == (3, 16)


def test_on_the_host_nothing_is_captured(doubling):
    recorded, numbers, calls = doubling
    for _ in range(4):
        recorded.run()
    assert (len(calls), recorded.replays, numbers.numpy()[0]) == (4, False, 16)


def test_a_capture_that_is_refused_is_not_tried_again_and_its_reason_kept(doubling, device, monkeypatch):
    recorded, numbers, calls = doubling
    monkeypatch.setattr(recording._State, "refusal", None)
    tried = []

    def refuse(**given):
        tried.append(given)
        raise RuntimeError("Graph capture failed: operation not permitted.\nmore words")

    monkeypatch.setattr(wp, "ScopedCapture", refuse)
    for _ in range(4):
        recorded.run()
    assert (len(tried), len(calls), numbers.numpy()[0]) == (1, 4, 16)
    assert recording.refusal() == "Graph capture failed: operation not permitted"


def test_a_graph_that_is_not_launched_is_called_instead_and_its_reason_kept(doubling, device, monkeypatch):
    recorded, numbers, calls = doubling
    monkeypatch.setattr(recording._State, "refusal", None)

    def refuse(graph):
        raise RuntimeError("Graph creation error: out of memory")

    monkeypatch.setattr(wp, "capture_launch", refuse)
    for _ in range(4):
        recorded.run()
    # Called, captured, called in its place, and so on.
    assert (len(calls), recorded.replays, numbers.numpy()[0]) == (5, False, 16)
    assert recording.refusal() == "Graph creation error: out of memory"


def test_captures_of_a_card_share_one_stream(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "Stream", lambda device: [device])
    monkeypatch.setattr(wp, "stream_from_torch", lambda stream: [stream])
    try:
        assert recording._aside("cuda:1") is recording._aside("cuda:1")
        assert recording._aside("cuda:0") == [["cuda:0"]]
    finally:
        recording._aside.cache_clear()


@pytest.mark.parametrize("every", [1, 3])
def test_replayed_renderings_are_those_that_were_called(make, device, every):
    case = make()
    weights = torch.randn(*case.size, 3, generator=torch.Generator().manual_seed(0))

    def iterate(backend, reuse, mask_set, scene):
        image, pull = backend.coded_with_pull(scene, case.poses, case.intrinsics, mask_set, reuse=reuse)
        by_poses = pull(weights)
        gradients = {name: tensor.grad for name, tensor in scene.parameters().items()}
        for tensor in scene.parameters().values():
            tensor.grad = None
        return {"image": image, "poses": by_poses, **gradients}

    def outcomes():
        backend = WarpBackend(RasterSettings(relist_every=every))
        reuse, mask_set = backend.reuse(), backend.code(case.masks)
        scene = case.scene.map(lambda one: one.clone().requires_grad_())
        found = []
        for _ in range(6):
            found.append(iterate(backend, reuse, mask_set, scene))
            with torch.no_grad():
                scene.means += torch.tensor([0.003, -0.002, 0.001])
        return found

    before = recording.captured()
    replayed = outcomes()
    assert recording.captured() >= before + 3
    places.count_host_as_device(yes=False)
    called = outcomes()
    for one, other in zip(replayed, called, strict=True):
        for name, tensor in other.items():
            assert torch.equal(torch.as_tensor(one[name]), torch.as_tensor(tensor)), name


def test_a_rendering_that_is_differentiated_later_keeps_what_it_needs(make):
    case, backend = make(), WarpBackend(RasterSettings(relist_every=2))
    mask_set, weights = backend.code(case.masks), np.ones((*case.size, 3), np.float32)

    def gradient(reuse, others):
        scene = case.scene.map(torch.clone)
        _, pull = backend.coded_with_pull(scene, case.poses, case.intrinsics, mask_set, reuse=reuse)
        moved = case.scene.map(torch.clone)
        moved.means += 0.1
        for _ in range(others):
            backend.coded_with_pull(moved, case.poses, case.intrinsics, mask_set, reuse=reuse)
        pull(weights)
        return scene.means.grad

    # After so many lists are due again: they must not be written where those of the first still lie.
    assert torch.equal(gradient(backend.reuse(), 3), gradient(backend.reuse(), 0))
