from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.special import sph_harm_y

from gs2ci.core.errors import InputError
from gs2ci.render.cpu.backend import CpuBackend
from gs2ci.render.cpu.harmonics import colours_of
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.harmonics import SH_DC, basis, coefficients, colours_seen, degree_of, turned
from tests.render.backends import to_the_end
from tests.render.reference import ReferenceBackend
from tests.render.se3 import exp

TOLERANCE = 2e-4
"""Relative, in the 2-norm: of float32 kernels against the definition."""


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


def one_gaussian(harmonics=None, colour=0.5):
    return Gaussians(
        torch.tensor([[1.0, 2.0, 3.0]]),
        torch.zeros(1, 3),
        torch.zeros(1, 4),
        torch.zeros(1),
        torch.full((1, 3), colour),
        harmonics=harmonics,
    )


def looking_from(centre):
    pose = torch.eye(4)
    pose[:3, 3] = -torch.tensor(centre)
    return pose


def test_the_direction_runs_from_the_camera_to_the_gaussian_and_not_along_the_cameras_axis():
    harmonics = torch.zeros(1, 3, 3)
    harmonics[0, 1] = 0.1  # the harmonic along z
    before, behind, beside = (
        colours_seen(one_gaussian(harmonics), looking_from(centre)[None])[0, 0, 0].item()
        for centre in ([1.0, 2.0, 0.0], [1.0, 2.0, 9.0], [5.0, 2.0, 3.0])
    )
    tilt = 0.1 * np.sqrt(3 / (4 * np.pi))
    assert (before, behind, beside) == pytest.approx((0.5 + tilt, 0.5 - tilt, 0.5), abs=1e-6)


def test_turning_the_camera_on_the_spot_changes_no_colour():
    harmonics = torch.randn(1, 15, 3, generator=torch.Generator().manual_seed(1)) * 0.1
    straight = looking_from([0.0, 0.0, 0.0])
    aside = straight.clone()
    aside[:3, :3] = torch.tensor([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])
    straight_colour, aside_colour = colours_seen(one_gaussian(harmonics), torch.stack([straight, aside]))
    torch.testing.assert_close(straight_colour, aside_colour)


def test_no_colour_is_negative():
    harmonics = torch.zeros(1, 3, 3)
    harmonics[0, 1] = -10.0
    assert (colours_seen(one_gaussian(harmonics), looking_from([1.0, 2.0, 0.0])[None]) == 0).all()


def test_a_degree_has_as_many_coefficients_as_files_hold():
    assert [coefficients(degree) for degree in range(4)] == [0, 3, 8, 15]


@pytest.mark.parametrize("degree", [-1, 4])
def test_other_degrees_are_refused(degree):
    with pytest.raises(InputError, match="allowed: 0 to 3"):
        coefficients(degree)


@pytest.mark.parametrize("shape", [(1, 4, 3), (2, 3, 3), (1, 3, 2), (3,)])
def test_coefficients_of_another_shape_are_refused(shape):
    with pytest.raises(InputError, match="harmonics of the Gaussians"):
        one_gaussian(torch.zeros(shape)).check()


def test_colours_that_change_with_nothing_have_no_direction():
    with pytest.raises(InputError, match="without harmonics"):
        colours_seen(one_gaussian(), torch.eye(4)[None])


def shiny(case, degree, size=0.3):
    generator = torch.Generator().manual_seed(11)
    harmonics = size * torch.randn(len(case.scene), coefficients(degree), 3, generator=generator)
    return replace(case, scene=replace(case.scene, harmonics=harmonics))


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("whole_views", [False, True])
def test_kernels_follow_the_definition(degree, whole_views, make, with_margin, run, fast):
    case = shiny(with_margin(lambda seed: make(seed=seed, count=37), whole_views=whole_views), degree)
    truth = run(ReferenceBackend(), case, whole_views=whole_views)
    found = run(to_the_end(fast), case, whole_views=whole_views)
    found.assert_near(truth, TOLERANCE)
    assert torch.linalg.vector_norm(truth.values["d harmonics"]) > 0


@pytest.mark.parametrize("degree", [1, 3])
def test_kernels_follow_the_definition_where_gaussians_move(make, degree):
    case = shiny(make(count=37), degree)
    draw = torch.Generator().manual_seed(6)
    scene = replace(case.scene, motion=0.5 * torch.randn(37, 2, 3, generator=draw))
    when, weights = torch.linspace(-1, 1, 3), torch.randn(3, 37, 3, generator=draw)
    found = []
    for dtype, see in ((torch.float64, colours_seen), (torch.float32, colours_of)):
        own = scene.map(lambda tensor: tensor.to(dtype, copy=True).requires_grad_())  # noqa: B023
        poses = case.poses.to(dtype, copy=True).requires_grad_()
        seen = see(own, poses, when.to(dtype))
        (seen * weights).sum().backward()
        gradients = (own.means.grad, own.colours.grad, own.harmonics.grad, own.motion.grad, poses.grad)
        found.append([one.double() for one in (seen.detach(), *gradients)])
    for truth, fast in zip(*found, strict=True):
        assert torch.linalg.vector_norm(fast - truth) < 1e-5 * torch.linalg.vector_norm(truth)


def test_definition_follows_finite_differences_in_all_that_colours_depend_on(make):
    case = shiny(make(count=6, size=(7, 9)), 3)
    # Half of the colours lie below zero, where nothing has a gradient.
    scene = case.scene.map(torch.Tensor.double)
    backend = ReferenceBackend()
    mask_set = backend.code(case.masks)
    twist = torch.zeros(len(case.poses), 6, dtype=torch.float64)

    def coded(means, colours, harmonics, twists):
        there = replace(scene, means=means, colours=colours, harmonics=harmonics)
        poses = exp(twists) @ case.poses.double()
        return backend.coded(there, poses, case.intrinsics, mask_set)

    given = [one.clone().requires_grad_() for one in (scene.means, scene.colours, scene.harmonics, twist)]
    assert torch.autograd.gradcheck(coded, given, eps=1e-6, atol=2e-6, fast_mode=True)
    seen = colours_seen(scene, case.poses.double())
    assert 0.05 < float((seen == 0).double().mean()) < 0.95


def test_the_direction_alone_has_a_gradient_by_place_and_pose(make):
    """What the picture of a Gaussian says of its place is one part; that its colour changes with it is another."""
    scene = shiny(make(count=5), 3).scene.map(torch.Tensor.double)
    poses = make(count=5).poses.double()
    scene.colours = scene.colours + 2  # all are above zero

    def seen(means, world_to_camera):
        return colours_seen(replace(scene, means=means), world_to_camera)

    given = [one.clone().requires_grad_() for one in (scene.means, poses)]
    assert torch.autograd.gradcheck(seen, given, eps=1e-6, atol=1e-7)


@pytest.mark.parametrize("backend", [CpuBackend(), ReferenceBackend()])
def test_harmonics_of_nothing_change_nothing(make, backend):
    case = make()
    case = replace(case, scene=replace(case.scene, colours=case.scene.colours.clamp(min=0)))
    dull = replace(case.scene, harmonics=torch.zeros(len(case.scene), 15, 3))
    masks = backend.code(case.masks)
    one, other = (backend.coded(scene, case.poses, case.intrinsics, masks) for scene in (case.scene, dull))
    assert torch.equal(one, other)


def test_colours_given_for_the_views_stand_for_the_harmonics_too(make):
    case = shiny(make(), 2)
    own = torch.rand(len(case.poses), len(case.scene), 3, generator=torch.Generator().manual_seed(2))
    for backend in (CpuBackend(), ReferenceBackend()):
        one, _ = backend.views(case.scene, case.poses, case.intrinsics, case.size, colours=own)
        dull = replace(case.scene, harmonics=None)
        other, _ = backend.views(dull, case.poses, case.intrinsics, case.size, colours=own)
        assert torch.equal(one, other)


def test_a_scene_that_moves_is_seen_from_where_it_stands(make):
    case = shiny(make(), 3)
    generator = torch.Generator().manual_seed(3)
    scene = replace(case.scene, motion=0.5 * torch.randn(len(case.scene), 2, 3, generator=generator))
    when = torch.linspace(-1, 1, len(case.poses))
    for backend in (CpuBackend(), ReferenceBackend()):
        together, _ = backend.views(scene, case.poses, case.intrinsics, case.size, times=when)
        for view, moment in enumerate(when.tolist()):
            alone, _ = backend.views(scene.at(moment), case.poses[view][None], case.intrinsics, case.size)
            torch.testing.assert_close(together[view], alone[0], rtol=0, atol=1e-5)


def a_rotation():
    return exp(torch.tensor([[0.3, -0.2, 0.5, 0.4, -1.1, 2.0]], dtype=torch.float64))[0]


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_turned_scene_looks_the_same_from_turned_places(make, degree):
    case = shiny(make(count=12), degree)
    scene, poses = case.scene.map(torch.Tensor.double), case.poses.double()
    turn = a_rotation()
    means = scene.means @ turn[:3, :3].T + turn[:3, 3]
    there = replace(scene, means=means, harmonics=turned(scene.harmonics, turn[:3, :3]))
    moved = poses @ torch.linalg.inv(turn)
    # The poses are rigid to single precision.
    torch.testing.assert_close(colours_seen(there, moved), colours_seen(scene, poses), rtol=0, atol=1e-6)
    assert float((there.harmonics - scene.harmonics).abs().max()) > 0.1


def test_degree_of_a_scene(make):
    case = make()
    assert [degree_of(case.scene), *(degree_of(shiny(case, degree).scene) for degree in (1, 2, 3))] == [0, 1, 2, 3]


@pytest.mark.parametrize("backend", [CpuBackend(), ReferenceBackend()])
def test_a_camera_inside_a_gaussian_leaves_finite_gradients(make, backend):
    case = shiny(make(count=20), 3)
    dtype = torch.float64 if backend.name == "reference" else torch.float32
    scene = case.scene.map(lambda tensor: tensor.detach().to(dtype))
    scene.means[0] = torch.linalg.inv(case.poses[1])[:3, 3].to(dtype)
    scene = scene.map(lambda tensor: tensor.clone().requires_grad_())
    poses = case.poses.to(dtype).clone().requires_grad_()
    backend.coded(scene, poses, case.intrinsics, backend.code(case.masks)).square().sum().backward()
    assert all(torch.isfinite(tensor.grad).all() for tensor in (*scene.parameters().values(), poses))
