"""Each kernel's counterpart for a device does what the kernel does, and reads nothing back."""

import numpy as np
import pytest
import torch

pytest.importorskip("warp", reason="Warp is not installed")

from gs2ci.reconstruct.fit.kernels import (
    calling,
    depth_field_kernels,
    gaussian_kernels,
    surface_kernels,
)
from gs2ci.reconstruct.fit.kernels.calling import call
from gs2ci.reconstruct.fit.kernels.device import calls, kernels
from gs2ci.reconstruct.fit.kernels.device.prepared import KeptLaunch
from gs2ci.reconstruct.fit.losses.device_losses import DataTermOnDevice
from gs2ci.reconstruct.fit.losses.objective import DataTerm, LossWeights
from gs2ci.reconstruct.fit.optimiser import view_steps
from gs2ci.reconstruct.fit.optimiser.gaussians import GaussianOptimiser, StepSizes
from gs2ci.reconstruct.fit.optimiser.view_steps import ReferenceView
from gs2ci.render import places, recording
from gs2ci.render.gaussians import Gaussians
from tests.reconstruct.fit.reading_back import reads
from tests.render.se3 import exp

GAUSSIANS = 500
NEAR = 0.05


@pytest.fixture
def device():
    """Let the host be a device."""
    places.count_host_as_device(yes=True)
    yield
    places.count_host_as_device(yes=False)


def draws(seed=0):
    return torch.Generator().manual_seed(seed)


def normal(*shape):
    return torch.randn(*shape, generator=normal.draws)


def scene():
    normal.draws = draws()
    means = normal(GAUSSIANS, 3)
    means[:, 2] = means[:, 2].abs() * 1.5 - 0.2  # some are behind the view, some nearer than the least depth
    return means, 0.3 * normal(GAUSSIANS, 3) - 3


POSE = exp(torch.tensor([0.05, -0.02, 0.03, 0.1, -0.2, 0.05], dtype=torch.float64)).numpy()
LOW, STEP = np.array([-0.8, -0.6, 0.3]), np.array([0.3, 0.35, 0.9])
FIELD = np.random.default_rng(0).normal(0, 0.05, (6, 5, 4))


def adam():
    parameter, gradient = normal(300), normal(300)
    constants = np.array([0.1, 0.999, 0.001, 3.1, 1e-15, 0.02], np.float32)
    return parameter, gradient, 0.1 * normal(300), normal(300) ** 2, constants


def surface():
    image, trust = normal(200, 3).abs(), torch.rand(200, generator=draws())
    return image, torch.arange(0, 200, 2), normal(200).abs(), trust, 9.0, 2.0, 0.3, 0.7, torch.zeros(200, 3)


RAY = torch.from_numpy(POSE[2]).float()
CASES = {
    gaussian_kernels.adam_step: adam,
    gaussian_kernels.add_opacity_gradient: lambda: (3 * normal(GAUSSIANS), 0.01, normal(GAUSSIANS)),
    gaussian_kernels.add_size_gradient: lambda: (normal(GAUSSIANS) - 3, 0.01, normal(GAUSSIANS)),
    view_steps.gradient_in_view: lambda: (
        *(scene()[0], normal(GAUSSIANS, 3), normal(GAUSSIANS, 3)),
        *(POSE, NEAR, torch.zeros(GAUSSIANS, 3)),
    ),
    view_steps.move_in_view: lambda: (*scene(), normal(GAUSSIANS, 3), POSE, NEAR, 0.01, 0.2),
    depth_field_kernels.gather_gradient: lambda: (
        *(scene()[0], normal(GAUSSIANS, 3), normal(GAUSSIANS, 3), POSE, NEAR, LOW, STEP),
        torch.zeros(6, 5, 4, dtype=torch.float64),
    ),
    depth_field_kernels.move_gaussians: lambda: (*scene(), POSE, NEAR, LOW, STEP, FIELD),
    depth_field_kernels.move_map: lambda: (
        *(normal(60) + 0.7, torch.arange(0, 60, 3), 0.4 * normal(60, 2), POSE, LOW, STEP, FIELD),
    ),
    surface_kernels.parallax_moments: lambda: (scene()[0], RAY, NEAR, 9.0, 2.0, torch.zeros(GAUSSIANS, 3)),
    surface_kernels.add_mean_gradient: lambda: (
        *(scene()[0], RAY, NEAR, 9.0, normal(GAUSSIANS, 3), normal(GAUSSIANS, 3), normal(GAUSSIANS, 3)),
    ),
    surface_kernels.distance_to_surface: surface,
}


@pytest.mark.parametrize("kernel", CASES, ids=lambda kernel: kernel.__name__)
def test_a_counterpart_does_what_the_kernel_does_and_reads_nothing_back(kernel, device):
    normal.draws = draws(1)
    given = CASES[kernel]()
    own = [one.clone() if isinstance(one, torch.Tensor) else one for one in given]
    with reads() as count:
        there = call(kernel, *given)
    assert count.total == 0
    places.count_host_as_device(yes=False)
    here = call(kernel, *own)
    written = 0
    for before, mine, other in zip(CASES_AGAIN(kernel), own, given, strict=True):
        if isinstance(mine, torch.Tensor):
            torch.testing.assert_close(other, mine, rtol=1e-5, atol=2e-6)
            written += not torch.equal(before, mine)
    if here is not None:
        assert float(there) == pytest.approx(float(here), rel=1e-6)
    assert written or here is not None


def test_an_image_that_is_a_part_of_what_was_rendered_is_read_where_it_lies(device):
    image, *given = surface()
    four = torch.cat([image, torch.full((200, 1), 7.0)], dim=1)
    apart = [call(surface_kernels.distance_to_surface, one, *given) for one in (image, four[:, :3], image)]
    assert float(apart[0]) == float(apart[1]) == float(apart[2])


def CASES_AGAIN(kernel):
    normal.draws = draws(1)
    return CASES[kernel]()


def test_nothing_is_called_on_a_device_for_tensors_of_the_host(monkeypatch):
    monkeypatch.setattr(calls, "counterpart", lambda name: pytest.fail(f"{name} called"))
    assert calling.call(gaussian_kernels.add_size_gradient, torch.zeros(12), 0.0, torch.zeros(12)) == 1


def test_launches_are_kept_for_many_places_but_not_for_all_that_ever_were(device):
    launch, constants = KeptLaunch(kernels.adam_step), np.array([0.1, 0.9, 0.1, 1, 0, 0.5], np.float32)
    every = [[torch.full((3,), float(k)) for k in (number, 1, 0, 0)] for number in range(40)]
    for _ in range(2):
        for parameter, *others in every:
            launch(3, parameter, *others, constants)
    assert 1 < len(vars(launch._own)) <= 16
    moved = torch.stack([one[0] for one in every])
    torch.testing.assert_close(moved - torch.arange(40.0)[:, None], moved[:1].expand(40, 3), rtol=0, atol=1e-5)
    assert moved[0, 0] < -0.1


@pytest.mark.parametrize("viewed", [False, True])
def test_a_step_of_all_parameters_is_that_of_the_host(viewed, device):
    view = ReferenceView(POSE, 300.0, 0.2) if viewed else None
    optimisers = []
    for there in (True, False):
        places.count_host_as_device(yes=there)
        normal.draws = draws(2)
        means, log_scales = scene()
        parts = (means, log_scales, normal(GAUSSIANS, 4), normal(GAUSSIANS), normal(GAUSSIANS, 3))
        optimiser = GaussianOptimiser(Gaussians(*parts), StepSizes(), 0.3, view)
        for turn in range(3):
            for tensor in optimiser.scene.parameters().values():
                tensor.grad = normal(*tensor.shape)
            optimiser.step(turn / 3, 0.5)
        optimisers.append(optimiser)
    there, here = optimisers
    for name, tensor in here.scene.parameters().items():
        torch.testing.assert_close(there.scene.parameters()[name], tensor, rtol=1e-5, atol=2e-6)


def term(size, channels, clipped, window_px):
    random = np.random.default_rng(0)
    measurement = random.random((*size, channels), dtype=np.float32) * 4
    predicted = measurement + random.normal(0, 0.1, measurement.shape).astype(np.float32)
    fitted, saturated = random.random(size) < 0.9, (random.random(size) < 0.2) if clipped else None
    return DataTerm(measurement, fitted, saturated, LossWeights(window_px=window_px), 0.4), predicted


@pytest.mark.parametrize("clipped", [False, True])
@pytest.mark.parametrize("window_px", [3, 11, 15])
@pytest.mark.parametrize("channels", [1, 3])
def test_the_data_term_is_that_of_the_host(clipped, window_px, channels, device):
    here, predicted = term((30, 41), channels, clipped, window_px)
    there = DataTermOnDevice(here, torch.device("cpu"))
    with reads() as count:
        value, gradient = there.value_and_gradient(torch.from_numpy(predicted))
        apart = there.dissimilarity(torch.from_numpy(predicted))
    assert count.total == 0
    exact, by_predicted = here.value_and_gradient(predicted)
    assert float(value) == pytest.approx(exact, rel=1e-6)
    np.testing.assert_allclose(gradient.numpy(), by_predicted, rtol=1e-3, atol=1e-4 * np.abs(by_predicted).max())
    np.testing.assert_allclose(apart.numpy(), here.dissimilarity(predicted), atol=2e-5)


def test_a_replayed_loss_is_that_of_the_first_call(device):
    here, predicted = term((24, 32), 3, True, 11)
    there, before = DataTermOnDevice(here, torch.device("cpu")), recording.captured()
    given = torch.from_numpy(predicted)
    called, gradient = there.value_and_gradient(given)
    gradient = gradient.clone()
    there.value_and_gradient(0.5 * given)
    assert recording.captured() == before + 1
    replayed, again = there.value_and_gradient(given)
    assert torch.equal(replayed, called)
    assert torch.equal(again, gradient)
