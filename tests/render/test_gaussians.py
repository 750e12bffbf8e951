import math

import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.render.gaussians import Gaussians, logit, rotation_matrices, transmittance_preserving_opacity


def test_parameters_and_map_reach_every_field(make):
    scene = make(count=12).scene
    assert list(scene.parameters()) == ["means", "log_scales", "quaternions", "opacity_logits", "colours"]
    half = scene.map(lambda t: t[::2])
    assert len(half) == 6
    assert torch.equal(half.colours, scene.colours[::2])


def test_detach_cuts_every_field_off_the_graph(make):
    scene = make().scene.map(lambda t: t.requires_grad_() * 1)
    assert not any(t.requires_grad for t in scene.detach().parameters().values())


@pytest.mark.parametrize("field", ["means", "log_scales", "quaternions", "opacity_logits", "colours"])
def test_check_refuses_a_field_of_the_wrong_length(field, make):
    fields = make(count=10).scene.parameters()
    fields[field] = fields[field][:-1] if field != "means" else fields[field][:, :2]
    with pytest.raises(InputError, match="of the Gaussians: float32"):
        Gaussians(**fields).check()


def test_check_refuses_whole_numbers(make):
    fields = make().scene.parameters()
    with pytest.raises(InputError, match="means of the Gaussians: int64"):
        Gaussians(**(fields | {"means": fields["means"].long()})).check()


def test_check_refuses_means_without_any_axis(make):
    with pytest.raises(InputError, match="means of the Gaussians"):
        Gaussians(**(make().scene.parameters() | {"means": torch.tensor(0.0)})).check()


def test_check_counts_the_values_that_are_not_finite(make):
    scene = make(count=10).scene
    scene.colours[2] = float("nan")
    with pytest.raises(InputError, match="colours of the Gaussians: 3 of 30 values"):
        scene.check()


def test_logit_undoes_the_sigmoid_far_from_the_middle():
    x = torch.linspace(-20, 14, 69, dtype=torch.float32)
    torch.testing.assert_close(logit(torch.sigmoid(x.double())).float(), x, rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(logit(torch.tensor([1e-9])), torch.tensor([math.log(1e-9)]))


@pytest.mark.parametrize("x", [-20.0, -7.0, -0.3, 0.0, 2.0, 9.0, 20.0])
def test_two_split_opacities_let_through_what_one_did(x):
    split = transmittance_preserving_opacity(torch.tensor([x])).double()
    # 1 - alpha = sigmoid(-x): compare transmittances where alpha is large and opacities where it is small.
    torch.testing.assert_close(
        2 * torch.nn.functional.logsigmoid(-split),
        torch.nn.functional.logsigmoid(-torch.tensor([x], dtype=torch.float64)),
        rtol=1e-6,
        atol=0,
    )


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_split_opacity_stays_finite_where_the_opacity_underflows(dtype):
    x = torch.tensor([-1000.0, -104.0, -50.0, 50.0, 1000.0], dtype=dtype, requires_grad=True)
    split = transmittance_preserving_opacity(x)
    split.sum().backward()
    assert torch.isfinite(split).all()
    assert torch.isfinite(x.grad).all()
    assert (split[1:] - split[:-1] >= 0).all()


def test_rotations_are_orthonormal_whatever_the_norm(make):
    q = torch.randn(50, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    q = q * torch.logspace(-10, 10, 50, dtype=torch.float64)[:, None]
    r = rotation_matrices(q)
    torch.testing.assert_close(r @ r.transpose(1, 2), torch.eye(3, dtype=torch.float64).expand(50, 3, 3))
    assert (torch.linalg.det(r) > 0).all()


def test_quarter_turn_about_z_takes_x_to_y():
    r = rotation_matrices(torch.tensor([math.cos(math.pi / 4), 0, 0, math.sin(math.pi / 4)]))
    torch.testing.assert_close(r @ torch.tensor([1.0, 0, 0]), torch.tensor([0.0, 1, 0]))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_zero_quaternion_is_the_identity_with_zero_gradient(dtype):
    q = torch.zeros(2, 4, dtype=dtype, requires_grad=True)
    r = rotation_matrices(q)
    assert torch.equal(r, torch.eye(3, dtype=dtype).expand(2, 3, 3))
    (r * torch.arange(9.0, dtype=dtype).reshape(3, 3)).sum().backward()
    assert not q.grad.any()
