"""A fit whose tensors lie on a device, for which the host stands in: the same fit, and little of it is read back."""

from dataclasses import replace

import numpy as np
import pytest
import torch

pytest.importorskip("warp", reason="Warp is not installed")

from gs2ci.reconstruct.fit.coarse.exposure import FittedExposure
from gs2ci.reconstruct.fit.coarse.looks import Monitoring
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse.state import FitState
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.render import places
from gs2ci.render.backend import load_backend
from gs2ci.render.warp import arrays
from tests.reconstruct.fit.plane_fits import fit_coarse
from tests.reconstruct.fit.reading_back import reads, said_to_lie_there

READS = 4
"""Numbers that an iteration waits for: the loss, whether the scene and its gradients are finite (2), and the gradients
by the poses."""


@pytest.fixture
def device():
    """Let the host be a device."""
    places.count_host_as_device(yes=True)
    yield
    places.count_host_as_device(yes=False)


def exposure_of(moving_plane):
    shot, geometry = moving_plane
    pixels = np.zeros(shot.size, bool)
    pixels[::7, ::5] = True
    return FittedExposure(
        Holdout(shot, pixels), ShotRenderer(shot, geometry.intrinsics, load_backend("warp")), geometry
    )


def settings(iterations=12):
    fit = CoarseSettings()
    return replace(fit, iterations=iterations, surfaces=None, mask_moments_from=0.0, hold_out=fit.hold_out.looking(4))


def iterate(fit, count):
    losses = []
    for number in range(count):
        losses.append(fit.backward(number / count, number))
        assert fit.is_finite(losses[-1])
        fit.step(number / count, 1.0)
    return losses


def test_the_first_iterations_are_those_of_the_host(moving_plane, scattered):
    here = FitState([exposure_of(moving_plane)], scattered(200), settings(), seed=0)
    losses = iterate(here, 6)
    places.count_host_as_device(yes=True)
    try:
        there = FitState([exposure_of(moving_plane)], scattered(200), settings(), seed=0)
        same = iterate(there, 6)
    finally:
        places.count_host_as_device(yes=False)
    np.testing.assert_allclose(same, losses, rtol=1e-4)
    for name, tensor in here.scene.parameters().items():
        torch.testing.assert_close(there.scene.parameters()[name], tensor, rtol=2e-3, atol=2e-3)


def test_an_iteration_waits_for_a_few_numbers_only(moving_plane, scattered, device, monkeypatch):
    fit = FitState([exposure_of(moving_plane)], scattered(200), settings(), seed=0)
    iterate(fit, 2)
    copied = arrays.copied
    monkeypatch.setattr(arrays, "copied", lambda *given: said_to_lie_there(copied(*given)))
    with reads(list(fit.scene.parameters().values())) as count:
        iterate(fit, 8)
    assert 8 * (READS - 1) < count.total <= 8 * READS, count.calls


def test_a_whole_fit_ends_as_good_as_on_the_host(moving_plane, scattered, device):
    there = fit_coarse(exposure_of(moving_plane), scattered(300), settings(40), 0, Monitoring())
    places.count_host_as_device(yes=False)
    here = fit_coarse(exposure_of(moving_plane), scattered(300), settings(40), 0, Monitoring())
    assert there.scene.means.is_cpu
    assert there.curve[-1].heldout == pytest.approx(here.curve[-1].heldout, rel=0.05)
    assert there.stopped.code is here.stopped.code
