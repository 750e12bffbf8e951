import numpy as np
import pytest
import torch
from scipy.special import sph_harm_y

from gs2ci.core.errors import InputError
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.harmonics import SH_DC, basis, coefficients, colours_seen


def sphere(count=2000, seed=0):
    points = np.random.default_rng(seed).standard_normal((count, 3))
    return torch.tensor(points / np.linalg.norm(points, axis=1, keepdims=True))


def real_harmonic(degree, order, directions):
    """The definition, from complex harmonics with Condon and Shortley's phase left in the real ones."""
    x, y, z = directions.numpy().T
    value = sph_harm_y(degree, abs(order), np.arccos(z), np.arctan2(y, x))
    if order == 0:
        return value.real
    return np.sqrt(2) * (value.imag if order < 0 else value.real)


def test_every_harmonic_is_that_of_its_definition():
    directions = sphere()
    expected = [real_harmonic(l, m, directions) for l in (1, 2, 3) for m in range(-l, l + 1)]  # noqa: E741
    np.testing.assert_allclose(basis(directions).numpy(), np.stack(expected, axis=1), atol=1e-12)


def test_harmonics_are_orthonormal_over_the_sphere():
    nodes, weights = np.polynomial.legendre.leggauss(8)
    angle = np.arange(16) / 16 * 2 * np.pi
    z, phi = (grid.ravel() for grid in np.meshgrid(nodes, angle, indexing="ij"))
    ring = np.sqrt(1 - z**2)
    values = basis(torch.tensor(np.stack([ring * np.cos(phi), ring * np.sin(phi), z], axis=1))).numpy()
    area = np.repeat(weights, 16) * 2 * np.pi / 16
    np.testing.assert_allclose(values.T @ (area[:, None] * values), np.eye(15), atol=1e-12)
    np.testing.assert_allclose(area @ values, 0, atol=1e-12)  # all are orthogonal to the constant one


def test_the_squares_of_one_degree_add_up_to_a_constant_in_every_direction():
    values = basis(sphere()).square()
    for degree, first in ((1, 0), (2, 3), (3, 8)):
        total = values[:, first : first + 2 * degree + 1].sum(dim=1)
        np.testing.assert_allclose(total, (2 * degree + 1) * SH_DC**2, atol=1e-12)


def one_gaussian(colour=0.5):
    return Gaussians(
        torch.tensor([[1.0, 2.0, 3.0]]),
        torch.zeros(1, 3),
        torch.zeros(1, 4),
        torch.zeros(1),
        torch.full((1, 3), colour),
    )


def looking_from(centre):
    pose = torch.eye(4)
    pose[:3, 3] = -torch.tensor(centre)
    return pose


def test_the_direction_runs_from_the_camera_to_the_gaussian_and_not_along_the_cameras_axis():
    harmonics = torch.zeros(1, 3, 3)
    harmonics[0, 1] = 0.1  # the harmonic along z
    before, behind, beside = (
        colours_seen(one_gaussian(), harmonics, looking_from(centre)[None])[0, 0, 0].item()
        for centre in ([1.0, 2.0, 0.0], [1.0, 2.0, 9.0], [5.0, 2.0, 3.0])
    )
    tilt = 0.1 * np.sqrt(3 / (4 * np.pi))
    assert (before, behind, beside) == pytest.approx((0.5 + tilt, 0.5 - tilt, 0.5), abs=1e-6)


def test_turning_the_camera_on_the_spot_changes_no_colour():
    harmonics = torch.randn(1, 15, 3, generator=torch.Generator().manual_seed(1)) * 0.1
    straight = looking_from([0.0, 0.0, 0.0])
    turned = straight.clone()
    turned[:3, :3] = torch.tensor([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])
    straight_colour, turned_colour = colours_seen(one_gaussian(), harmonics, torch.stack([straight, turned]))
    torch.testing.assert_close(straight_colour, turned_colour)


def test_no_colour_is_negative():
    harmonics = torch.zeros(1, 3, 3)
    harmonics[0, 1] = -10.0
    assert (colours_seen(one_gaussian(), harmonics, looking_from([1.0, 2.0, 0.0])[None]) == 0).all()


def test_a_degree_has_as_many_coefficients_as_files_hold():
    assert [coefficients(degree) for degree in range(4)] == [0, 3, 8, 15]


@pytest.mark.parametrize("degree", [-1, 4])
def test_other_degrees_are_refused(degree):
    with pytest.raises(InputError, match="allowed: 0 to 3"):
        coefficients(degree)


@pytest.mark.parametrize("shape", [(1, 4, 3), (2, 3, 3), (1, 3, 2), (3,)])
def test_coefficients_of_another_shape_are_refused(shape):
    with pytest.raises(InputError, match="spherical harmonics"):
        colours_seen(one_gaussian(), torch.zeros(shape), torch.eye(4)[None])
