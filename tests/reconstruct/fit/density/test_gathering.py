"""What a rule decides on, against its definitions."""

import numpy as np
import pytest
import torch

from gs2ci.core.records import Shot
from gs2ci.reconstruct.fit.density.gathering import Gathering
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.render.cpu.backend import CpuBackend
from tests.render.reference import ReferenceBackend

SIZE = (20, 27)
INTRINSICS = torch.tensor([[30.0, 0, 13.5], [0, 30, 10], [0, 0, 1]])


def poses(views):
    moved = torch.eye(4).repeat(views, 1, 1)
    moved[:, 0, 3] = torch.linspace(-0.05, 0.05, views)
    return moved


def gathering(masks, count, backend=None, size=SIZE, *, comparable=True):
    shot = Shot(np.zeros((*size, 3), np.float32), masks.numpy(), np.ones(len(masks), np.float32))
    renderer = ShotRenderer(shot, INTRINSICS.numpy(), backend or CpuBackend())
    return Gathering([renderer], count, comparable=comparable)


def shared_evidence(gathered, scene, error=None):
    def look_up():
        assert error is not None
        return [error]

    path = poses(len(gathered._renderers[0].transmissions))
    return gathered.evidence(scene, [path], look_up, extent=0.3, cap=7, iteration=11)


def test_a_share_of_open_pixels_does_not_change_the_unit_of_gradients(scattered):
    """The threshold of the rules is that of photographs, all of whose pixels are seen."""
    scene = scattered(5)
    for share in (1.0, 0.25):
        gathered = gathering(torch.full((2, *SIZE), share), 5)
        gathered.screen.add(torch.full((5,), share * 4e-4), torch.full((5,), 2.0), torch.full((5,), 3.0))
        torch.testing.assert_close(shared_evidence(gathered, scene).screen_gradient, torch.full((5,), 2e-4))


def test_what_a_shift_of_a_pixel_changes_counts_alike_in_larger_pictures(scattered):
    """A Gaussian's error of so many readings: its share of the mean loss falls with the picture's number of pixels."""
    found = []
    for height, width in ((96, 128), (128, 96), (160, 240)):
        gathered = gathering(torch.ones(2, height, width), 5, size=(height, width))
        by_shift_px = torch.full((5,), 1.0 / (height * width))
        half_size_px = 0.5 * (height * width) ** 0.5
        gathered.screen.add(by_shift_px * half_size_px, torch.ones(5), torch.full((5,), 3.0))
        found.append(shared_evidence(gathered, scattered(5)).screen_gradient)
    for one in found:
        torch.testing.assert_close(one, torch.full((5,), 0.5 / (96 * 128) ** 0.5))


def test_a_rule_of_the_paper_gets_gradients_as_they_are(scattered):
    masks = torch.full((2, *SIZE), 0.25)
    gathered = gathering(masks, 5, comparable=False)
    gathered.screen.add(torch.full((5,), 4e-4), torch.full((5,), 2.0), torch.full((5,), 3.0))
    torch.testing.assert_close(shared_evidence(gathered, scattered(5)).screen_gradient, torch.full((5,), 2e-4))


def test_short_exposures_do_not_change_the_unit_of_gradients(scattered):
    """The loss is in units of the exposure: half-open masks pass half of its gradient, however short they are shown."""
    scene, weights = scattered(5), np.array([0.0, 0.05, 0.15], np.float32)
    shot = Shot(np.zeros((*SIZE, 3), np.float32), np.full((3, *SIZE), 0.5, np.float32), weights)
    renderer = ShotRenderer(shot, INTRINSICS.numpy(), CpuBackend())
    assert renderer.exposure == pytest.approx(0.1)
    gathered = Gathering([renderer], 5)
    gathered.screen.add(torch.full((5,), 4e-4 / 3), torch.full((5,), 1.0), torch.full((5,), 3.0))
    torch.testing.assert_close(shared_evidence(gathered, scene).screen_gradient, torch.full((5,), 4e-4))


def test_radii_are_shares_of_the_longer_side(scattered):
    gathered = gathering(torch.ones(2, *SIZE), 3)
    gathered.screen.add(torch.zeros(3), torch.ones(3), torch.tensor([0.0, 2.7, 27.0]))
    seen = shared_evidence(gathered, scattered(3))
    torch.testing.assert_close(seen.screen_radius, torch.tensor([0.0, 0.1, 1.0]))
    assert (seen.extent, seen.cap, seen.iteration) == (0.3, 7, 11)


def test_masks_that_are_closed_throughout_leave_the_gradients_finite(scattered):
    assert torch.isfinite(shared_evidence(gathering(torch.zeros(2, *SIZE), 3), scattered(3)).screen_gradient).all()


@pytest.mark.parametrize("backend", [CpuBackend, ReferenceBackend])
def test_each_gaussians_part_in_the_error_is_the_sum_of_its_blending_weights_times_the_error(scattered, backend):
    """Weight of a Gaussian in a pixel: what the image loses when that Gaussian alone turns from white to black."""
    draw = torch.Generator().manual_seed(1)
    scene, error = scattered(6, seed=3), torch.rand(SIZE, generator=draw)
    masks = (torch.rand(3, *SIZE, generator=draw) < 0.4).float() * 0.7
    part = shared_evidence(gathering(masks, 6, backend()), scene, error).blended_error()
    expected = torch.zeros(6)
    for index in range(6):
        alone = torch.zeros(3, 6, 3)
        alone[:, index] = 1
        weights, _ = backend().views(scene, poses(3), INTRINSICS, SIZE, colours=alone)
        by_view = (weights[..., 0] * (masks > 0) * error).sum(dim=(1, 2))
        expected[index] = by_view.max()
    torch.testing.assert_close(part, expected, rtol=1e-4, atol=1e-5)
    assert (part > 0).all()


def test_looking_up_errors_leaves_the_gradients_of_the_fit_alone(scattered):
    scene = scattered(6).map(lambda tensor: tensor.requires_grad_(True))
    gathered = gathering(torch.ones(2, *SIZE), 6)
    shared_evidence(gathered, scene, torch.ones(SIZE)).blended_error()
    assert all(tensor.grad is None for tensor in scene.parameters().values())
    assert not gathered.screen.sightings.any()
