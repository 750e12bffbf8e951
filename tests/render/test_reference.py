"""The definition against what can be worked out by hand."""

import math

import pytest
import torch

from gs2ci.render.conventions import ALPHA_MAX, DILATION_PX2, NEAR
from gs2ci.render.gaussians import Gaussians
from tests.render.reference import ReferenceBackend

SIZE = (9, 11)
INTRINSICS = torch.tensor([[20.0, 0, 5.5], [0, 20.0, 4.5], [0, 0, 1]])
POSE = torch.eye(4)[None]


def gaussian(mean=(0.0, 0.0, 4.0), scale=0.2, logit=1.0, colour=(0.2, 0.5, 0.9)):
    return Gaussians(
        means=torch.tensor([mean]),
        log_scales=torch.full((1, 3), math.log(scale)),
        quaternions=torch.tensor([[1.0, 0, 0, 0]]),
        opacity_logits=torch.tensor([logit]),
        colours=torch.tensor([colour]),
    )


def both(a, b):
    return Gaussians(**{k: torch.cat([v, b.parameters()[k]]) for k, v in a.parameters().items()})


def test_ball_on_the_axis_is_a_round_spot_of_known_width():
    images, alphas = ReferenceBackend().views(gaussian(), POSE, INTRINSICS, SIZE)
    variance_px2 = (20 * 0.2 / 4) ** 2 + DILATION_PX2
    opacity = 1 / (1 + math.exp(-1))
    assert alphas[0, 4, 5].item() == pytest.approx(opacity, abs=1e-7)
    assert alphas[0, 4, 7].item() == pytest.approx(opacity * math.exp(-2 / variance_px2), abs=1e-7)
    torch.testing.assert_close(
        images[0], alphas[0, ..., None] * torch.tensor([0.2, 0.5, 0.9], dtype=torch.float64), rtol=1e-6, atol=0
    )


def test_nearer_gaussian_covers_the_farther_one_whatever_their_order():
    near = gaussian(mean=(0, 0, 3.0), logit=0.5, colour=(1.0, 0, 0))
    far = gaussian(mean=(0, 0, 6.0), logit=2.0, colour=(0, 1.0, 0))
    backend = ReferenceBackend()
    one, _ = backend.views(both(near, far), POSE, INTRINSICS, SIZE)
    other, _ = backend.views(both(far, near), POSE, INTRINSICS, SIZE)
    a, b = 1 / (1 + math.exp(-0.5)), 1 / (1 + math.exp(-2))
    torch.testing.assert_close(one, other)
    torch.testing.assert_close(one[0, 4, 5], torch.tensor([a, (1 - a) * b, 0], dtype=torch.float64), rtol=1e-6, atol=0)


@pytest.mark.parametrize(("depth", "seen"), [(-1.0, False), (0.0, False), (NEAR, False), (NEAR * 1.01, True)])
def test_only_centres_beyond_the_near_plane_are_drawn(depth, seen):
    _, alphas = ReferenceBackend().views(gaussian(mean=(0, 0, depth)), POSE, INTRINSICS, SIZE)
    assert bool(alphas.any()) == seen


def test_alpha_is_cut_at_both_ends():
    _, alphas = ReferenceBackend().views(gaussian(scale=0.02, logit=20.0), POSE, INTRINSICS, SIZE)
    assert alphas[0, 4, 5].item() == pytest.approx(ALPHA_MAX)
    assert alphas[0, 0, 0].item() == 0


def test_margin_tells_how_near_an_alpha_is_to_a_threshold():
    backend = ReferenceBackend()
    backend.views(gaussian(logit=math.log(0.999 / 0.001) + 1e-3), POSE, INTRINSICS, SIZE)
    assert 0 < backend.margin < 1e-5


def test_gradients_agree_with_finite_differences(make):
    case = make(seed=3, count=3, views=1, size=(4, 5))
    backend = ReferenceBackend()
    coding = backend.code(torch.ones(1, 4, 5))
    fields = [t.double().requires_grad_() for t in case.scene.parameters().values()]
    poses = case.poses.double().requires_grad_()

    def coded(*tensors):
        return backend.coded(Gaussians(*tensors[:5]), tensors[5], case.intrinsics.double(), coding)

    assert torch.autograd.gradcheck(coded, (*fields, poses), eps=1e-7, atol=1e-6)
