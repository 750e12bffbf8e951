"""GAP with total variation on a device does what the CPU's kernels do, and is chosen where it can be."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode import pnp
from gs2ci.reconstruct.decode.device_gap import projected, smoothed
from gs2ci.reconstruct.decode.gap_tv import GapTvSettings, decode_signed
from gs2ci.reconstruct.decode.kernels import denoise_planes, project_onto_measurement
from gs2ci.render import places
from tests.reconstruct.fit.reading_back import reads


@pytest.fixture
def device():
    """Let the host be a device."""
    places.count_host_as_device(yes=True)
    yield
    places.count_host_as_device(yes=False)


def draws(*shape, seed=0):
    return np.random.default_rng(seed).random(shape, dtype=np.float32)


@pytest.mark.parametrize("noisy", [False, True])
def test_a_projection_is_that_of_the_kernel(noisy):
    views, masks, measured = draws(3, 2, 9, 11), draws(3, 9, 11, seed=1), draws(2, 9, 11, seed=2)
    inverse, target = np.where(draws(9, 11, seed=3) < 0.2, 0, 1).astype(np.float32), draws(2, 9, 11, seed=4)
    noise = np.where(draws(2, 9, 11, seed=5) < 0.3, 0, draws(2, 9, 11, seed=6)).astype(np.float32)
    given = [torch.from_numpy(one.copy()) for one in (views, target, masks, measured, inverse)]
    there, goal, energy = projected(*given, torch.from_numpy(noise) if noisy else None, 0.4)
    none = np.zeros((0, 0, 0), np.float32)
    rows = project_onto_measurement(views, masks, inverse, measured, target, noise if noisy else none, 0.4)
    np.testing.assert_allclose(there.numpy(), views, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(goal.numpy(), target, rtol=1e-5, atol=1e-6)
    assert float(energy) == pytest.approx(rows.sum(), rel=1e-6)


@pytest.mark.parametrize("size", [(9, 11), (1, 7), (8, 1)])
def test_smoothing_is_that_of_the_kernel(size):
    views = draws(2, 3, *size) * 2 - 0.5
    there = smoothed(torch.from_numpy(views), 0.08, 5)
    denoise_planes(views.reshape(-1, *size), 0.08, 5)
    np.testing.assert_allclose(there.numpy(), views, rtol=1e-5, atol=2e-6)


def shot(channels=3, cfa=None):
    masks = (draws(4, 16, 20, seed=7) < 0.5).astype(np.float32)
    truth = draws(4, 16, 20, channels, seed=8)
    coded = (masks[..., None] * truth).sum(axis=0)
    return Shot(coded, masks, np.ones(4, np.float32), cfa=cfa)


SETTINGS = GapTvSettings(iterations=6)


@pytest.mark.parametrize("noise", [None, 1e-3])
def test_a_decode_is_that_of_the_host(noise, device):
    power = None if noise is None else np.full((16, 20, 3), noise, np.float32)
    with reads() as count:
        there = decode_signed(shot(), SETTINGS, noise=power)
    assert count.calls == {"__float__": SETTINGS.iterations, "cpu": 1, "numpy": 1}
    places.count_host_as_device(yes=False)
    np.testing.assert_allclose(there, decode_signed(shot(), SETTINGS, noise=power), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    "which",
    [(shot(1, "RGGB"), SETTINGS), (shot(), replace(SETTINGS, coupling=0.3)), (shot(), replace(SETTINGS, clamped=True))],
)
def test_what_a_device_has_no_form_of_stays_on_the_host(which, device, monkeypatch):
    monkeypatch.setattr(pnp, "gap_on_device", lambda *_: pytest.fail("called"))
    there = decode_signed(*which)
    places.count_host_as_device(yes=False)
    assert np.array_equal(there, decode_signed(*which))
