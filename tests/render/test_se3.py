"""Group laws and the angles at which naive formulae break."""

import math

import pytest
import torch

from tests.render import se3

ANGLES = [0.0, 1e-8, 1e-4, 0.3, 0.4999, 0.5001, 1.5, 3.0, math.pi - 1e-3, math.pi - 1e-6]
AXIS = (0.36, -0.48, 0.8)
TOLERANCE = {torch.float32: 2e-6, torch.float64: 1e-13}


def twist(angle, dtype):
    phi = torch.tensor(AXIS, dtype=dtype) * angle
    return torch.cat([torch.tensor([0.3, -2.0, 1.0], dtype=dtype), phi])


@pytest.mark.parametrize("dtype", list(TOLERANCE))
@pytest.mark.parametrize("angle", ANGLES)
def test_exp_agrees_with_the_matrix_exponential(angle, dtype):
    xi = twist(angle, dtype)
    generator = torch.zeros(4, 4, dtype=torch.float64)
    generator[:3, :3], generator[:3, 3] = se3.hat(xi[3:]), xi[:3]
    expected = torch.linalg.matrix_exp(generator)
    assert (se3.exp(xi).double() - expected).abs().max() < TOLERANCE[dtype]
    assert (se3.so3_exp(xi[3:]).double() - expected[:3, :3]).abs().max() < TOLERANCE[dtype]


@pytest.mark.parametrize("dtype", list(TOLERANCE))
@pytest.mark.parametrize("angle", ANGLES)
def test_log_undoes_exp(angle, dtype):
    xi = twist(angle, dtype)
    assert (se3.log(se3.exp(xi)) - xi).abs().max() < TOLERANCE[dtype]
    assert (se3.so3_log(se3.so3_exp(xi[3:])) - xi[3:]).abs().max() < TOLERANCE[dtype]


@pytest.mark.parametrize("dtype", list(TOLERANCE))
@pytest.mark.parametrize("angle", ANGLES)
def test_derivative_of_log_after_exp_is_the_identity(angle, dtype):
    jacobian = torch.autograd.functional.jacobian(lambda x: se3.log(se3.exp(x)), twist(angle, dtype))
    assert (jacobian - torch.eye(6, dtype=dtype)).abs().max() < 10 * TOLERANCE[dtype]


@pytest.mark.parametrize("angle", [0.0, 1e-8, math.pi - 1e-6])
def test_derivative_of_exp_agrees_with_finite_differences(angle):
    assert torch.autograd.gradcheck(se3.exp, twist(angle, torch.float64).requires_grad_(), atol=1e-7)


def test_log_of_a_half_turn_has_angle_pi():
    rotation = torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
    torch.testing.assert_close(se3.so3_log(rotation).abs(), torch.tensor([math.pi, 0, 0], dtype=torch.float64))


def test_inverse_undoes_a_motion():
    motions = se3.exp(torch.randn(7, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(1)))
    eye = torch.eye(4, dtype=torch.float64).expand(7, 4, 4)
    torch.testing.assert_close(se3.inverse(motions) @ motions, eye)
    torch.testing.assert_close(motions @ se3.inverse(motions), eye)


def test_small_motions_compose_by_adding():
    a, b = twist(1e-6, torch.float64) * 1e-6, twist(0.5, torch.float64) * 1e-6
    assert (se3.log(se3.exp(a) @ se3.exp(b)) - (a + b)).abs().max() < 1e-11


def test_any_number_of_leading_axes_is_kept():
    xi = torch.randn(2, 3, 6, generator=torch.Generator().manual_seed(2))
    assert se3.exp(xi).shape == (2, 3, 4, 4)
    torch.testing.assert_close(se3.exp(xi)[1, 2], se3.exp(xi[1, 2]))
    assert se3.log(se3.exp(xi)).shape == (2, 3, 6)
    assert se3.exp(xi[:0]).shape == (0, 3, 4, 4)


@pytest.mark.parametrize("dtype", list(TOLERANCE))
def test_small_motions_are_the_same_beside_a_large_one(dtype):
    # Alone, small ones need no closed form, and take another way.
    small = torch.stack([twist(angle, dtype) for angle in (0.0, 1e-4, 0.3, 0.4999)]).requires_grad_()
    alone, beside = se3.exp(small), se3.exp(torch.cat([small, twist(2.0, dtype)[None]]))[:-1]
    assert (alone - beside).abs().max() < TOLERANCE[dtype]
    weights = torch.arange(alone.numel(), dtype=dtype).reshape(alone.shape)
    slopes = [torch.autograd.grad((motion * weights).sum(), small, retain_graph=True)[0] for motion in (alone, beside)]
    assert torch.isfinite(slopes[0]).all()
    torch.testing.assert_close(*slopes, rtol=50 * TOLERANCE[dtype], atol=50 * TOLERANCE[dtype])
