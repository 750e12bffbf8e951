"""The radiance field against closed forms in float64."""

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from tests.tables.radiance_field import (
    Frustum,
    HashGrid,
    RadianceField,
    cast,
    composite,
    edges_along,
)

CAMERA = np.array([[40.0, 0, 16], [0, 40, 12], [0, 0, 1]])
FRUSTUM = Frustum(CAMERA, (24, 32), nearest=2.0, farthest=0.25)


def test_light_through_slabs_is_that_of_the_closed_form():
    """Slabs of even density are integrated exactly, whatever their lengths: ∫ σ c exp(−∫σ) in float64."""
    rng = np.random.default_rng(0)
    density, colour = rng.gamma(0.5, 8.0, (50, 7)), rng.random((50, 7, 3))
    edges = np.sort(rng.random((50, 8)), axis=1)
    thickness = density * np.diff(edges, axis=1)
    deep = np.concatenate([np.zeros((50, 1)), np.cumsum(thickness, axis=1)], axis=1)
    share = np.exp(-deep[:, :-1]) - np.exp(-deep[:, 1:])
    share[:, -1] = np.exp(-deep[:, -2])
    seen, found = composite(*(torch.from_numpy(a).float() for a in (density, colour, edges)))
    np.testing.assert_allclose(found.numpy(), share, atol=1e-6)
    np.testing.assert_allclose(seen.numpy(), (share[..., None] * colour).sum(axis=1), atol=2e-6)


@pytest.mark.parametrize("density", [0.0, 1e-12, np.exp(12.0)])
def test_empty_and_opaque_rays_send_all_their_light_and_finite_gradients(density):
    sigma = torch.full((3, 5), density, requires_grad=True)
    edges, _ = edges_along(3, 5, None)
    _, shares = composite(sigma, torch.rand(3, 5, 3), edges)
    assert torch.allclose(shares.sum(dim=1), torch.ones(3))
    assert int(shares[0].argmax()) == (0 if density > 1 else 4)
    shares[:, 0].sum().backward()
    assert torch.isfinite(sigma.grad).all()


def test_samples_lie_in_their_intervals():
    edges, along = edges_along(20, 6, torch.Generator().manual_seed(0))
    assert ((along >= edges[:, :-1]) & (along <= edges[:, 1:])).all()
    assert torch.allclose(edges_along(1, 6, None)[1], (edges[:1, 1:] + edges[:1, :-1]) / 2)


@pytest.mark.parametrize("entries", [2**12, 2**4])
def test_features_are_those_at_the_corners_and_even_between_them(entries):
    """Dense tables, and tables so small that places share entries."""
    grid = HashGrid((4, 3, 5), (4, 3, 5), 1, entries, 2, torch.Generator().manual_seed(0))
    sides = torch.tensor([4, 3, 5])
    with torch.no_grad():
        grid.tables[0].copy_(torch.randn(grid.tables[0].shape, generator=torch.Generator().manual_seed(1)))
        corner = torch.tensor([[1, 2, 3]])
        eight = grid((corner + grid.corners) / sides)
        offset = torch.tensor([0.3, 0.6, 0.1])
        share = torch.where(grid.corners.bool(), offset, 1 - offset).prod(dim=1)
        between = grid((corner + offset) / sides)[0]
    assert torch.allclose(between, share @ eight, atol=1e-5)


def test_a_hash_grid_passes_its_gradient_to_the_places():
    grid = HashGrid((4, 4, 4), (9, 9, 9), 2, 2**6, 2, torch.Generator().manual_seed(0)).double()
    with torch.no_grad():
        for table in grid.tables:
            table.copy_(torch.randn(table.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64))
    places = torch.rand(5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(3)).requires_grad_(True)
    assert torch.autograd.gradcheck(grid, (places,), eps=1e-7, atol=1e-5)


def test_the_frustum_is_the_reference_camera_s_view_between_its_planes():
    pixel, inverse = torch.tensor([[8.0, 18.0]]), torch.tensor([2.0, 0.25])
    rays = torch.cat([(pixel - torch.tensor([16.0, 12])) / 40, torch.ones(1, 1)], dim=1)
    near, far = FRUSTUM.inside(rays / inverse[:, None])
    assert near.tolist() == pytest.approx([(8 / 32 + 0.25) / 1.5, (18 / 24 + 0.25) / 1.5, 0.0])
    assert far.tolist() == pytest.approx([*near[:2].tolist(), 1.0])
    behind = FRUSTUM.inside(torch.tensor([[0.1, 0.1, -1.0]]))
    assert torch.isfinite(behind).all()
    assert FRUSTUM.inverse_depths(torch.tensor([0.0, 1.0])).tolist() == [2.0, 0.25]


def test_a_plane_is_seen_where_it_stands():
    """A field that is opaque from one inverse depth on; a camera that has moved along its axis sees it nearer."""

    class Wall(RadianceField):
        def forward(self, points, directions):
            density = torch.where(1 / points[:, 2] <= 1.0, 1e4, 0.0)
            return density, torch.ones_like(points)

    pose = torch.eye(4).repeat(2, 1, 1)
    pose[1, 2, 3] = -0.2
    seen, inverse = cast(Wall(FRUSTUM, torch.Generator()), pose, torch.tensor([[16.0, 12.0]] * 2), samples=200)
    assert torch.allclose(seen, torch.ones(2, 3))
    assert inverse.tolist() == pytest.approx([1.0, 1 / 0.8], rel=0.02)


@pytest.mark.parametrize("planes", [(0.2, 0.2), (0.2, 0.0), (np.inf, 0.1), (0.1, 0.2)])
def test_planes_that_enclose_nothing_are_refused(planes):
    with pytest.raises(InputError, match="a field between"):
        Frustum(CAMERA, (24, 32), *planes)
