"""What Warp says of this computer, and the rendering by which a device is tried, here the CPU by fibers."""

import pytest

pytest.importorskip("warp", reason="Warp is not installed")

from gs2ci.core.errors import InputError
from gs2ci.render import trial
from gs2ci.render.backend import load_backend
from gs2ci.render.devices import MOST_ERROR, CudaProbe
from gs2ci.render.trial import cuda_here, error_on


def test_a_device_that_works_agrees_with_the_cpu():
    error = error_on("cpu")
    assert 0 < error < MOST_ERROR / 20
    assert error == error_on("cpu")


def test_a_device_that_is_not_there_is_refused():
    with pytest.raises(InputError, match="no device 'cuda:9'"):
        error_on("cuda:9")


@pytest.mark.parametrize("spoilt", [1, 3], ids=["called", "replayed"])
@pytest.mark.parametrize("wrong", ["scaled", "nan"])
def test_a_device_that_computes_something_else_is_found_out(monkeypatch, wrong, spoilt):
    outcome = trial._outcome

    def spoiled(backend, renderings):
        image, *others = outcome(backend, renderings)
        if backend.name == "warp" and renderings == spoilt:
            others[-1] = others[-1] * (1.01 if wrong == "scaled" else float("nan"))
        return [image, *others]

    monkeypatch.setattr(trial, "_outcome", spoiled)
    assert error_on("cpu") > MOST_ERROR


def test_the_scene_of_the_trial_has_all_gradients():
    image, *gradients = trial._outcome(load_backend("cpu"), 2)
    assert image.shape == (24, 32, 3)
    assert len(gradients) == 6
    assert all(bool(one.abs().max() > 0) for one in [image, *gradients])


def test_warp_names_the_oldest_card_and_driver_that_it_compiles_for():
    found = cuda_here()
    assert (7, 5) <= found.least_capability <= (9, 0)
    assert found.least_driver >= (12, 0)
    assert all(card.capability >= (1, 0) and card.memory_mib > 0 for card in found.cards)
    assert (found.driver is None) <= (not found.cards)


def test_a_computer_is_asked_through_these():
    assert CudaProbe().cuda() == cuda_here()
    assert CudaProbe().error_on("cpu") == error_on("cpu")
