import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.render.cpu.backend import CpuBackend
from gs2ci.render.screen import RADIUS_SIGMAS, ScreenStatistics
from tests.render.backends import load_backend, to_the_end
from tests.render.reference import ReferenceBackend


def statistics_of(backend, case, renderings=1):
    scene = case.scene.map(lambda tensor: tensor.clone().requires_grad_(True))
    seen = ScreenStatistics.empty(len(scene))
    pull = torch.linspace(-1, 1, 3 * case.masks[0].numel()).reshape(*case.size, 3)
    for _ in range(renderings):
        coded = backend.coded(scene, case.poses, case.intrinsics, backend.code(case.masks), seen)
        (coded * pull).sum().backward()
    return seen


@pytest.mark.parametrize("seed", range(3))
def test_the_fast_path_sees_what_the_definition_sees(seed, make, with_margin, fast):
    case = with_margin(lambda attempt: make(10 * seed + attempt, count=60, size=(21, 17)))
    seen, truth = statistics_of(to_the_end(fast), case), statistics_of(ReferenceBackend(), case)
    torch.testing.assert_close(seen.sightings, truth.sightings, rtol=0, atol=0)
    torch.testing.assert_close(seen.radius_px, truth.radius_px, rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(seen.gradient_sum, truth.gradient_sum, rtol=1e-3, atol=1e-4)
    assert (truth.gradient_sum > 0).any()


def test_the_gradient_is_that_by_the_screen_position_in_half_image_sizes(make, change):
    """Moving a lone Gaussian by h px changes the loss by h times its gradient there."""
    case = make(count=1, views=1, size=(20, 30), open_share=1.0)
    case = change(case, means=torch.tensor([[0.1, -0.05, 3.0]]), log_scales=torch.full((1, 3), -1.5))
    seen = statistics_of(ReferenceBackend(), case)
    focal, h = case.intrinsics.diagonal()[:2].double(), 1e-4

    def loss(dx_px, dy_px):
        centre = case.intrinsics.double().clone()
        centre[0, 2] += dx_px
        centre[1, 2] += dy_px
        backend = ReferenceBackend()
        image = backend.coded(case.scene, case.poses, centre, backend.code(case.masks))
        return float((image * torch.linspace(-1, 1, image.numel()).reshape(image.shape)).sum())

    assert (focal > 0).all()
    by_x, by_y = ((loss(h, 0) - loss(-h, 0)) / (2 * h), (loss(0, h) - loss(0, -h)) / (2 * h))
    expected = ((15 * by_x) ** 2 + (10 * by_y) ** 2) ** 0.5
    assert float(seen.gradient_sum[0]) == pytest.approx(expected, rel=0.02)


def test_sums_grow_with_the_renderings_and_the_mean_does_not(make):
    case = make()
    once, thrice = statistics_of(CpuBackend(), case), statistics_of(CpuBackend(), case, renderings=3)
    torch.testing.assert_close(thrice.gradient_sum, 3 * once.gradient_sum)
    torch.testing.assert_close(thrice.sightings, 3 * once.sightings)
    torch.testing.assert_close(thrice.radius_px, once.radius_px)
    torch.testing.assert_close(thrice.mean_gradient(), once.mean_gradient())


def test_a_round_gaussian_on_the_axis_has_the_radius_of_its_sigma(make, change):
    case = make(count=1, views=1, size=(31, 31), open_share=1.0)
    focal = float(case.intrinsics[0, 0])
    principal = case.intrinsics[:2, 2]
    centred = change(
        case,
        means=torch.tensor([[0.0, 0.0, 2.0]]),
        log_scales=torch.full((1, 3), 0.1).log(),
        opacity_logits=torch.tensor([2.0]),
    )
    assert (principal > 5).all()
    seen = statistics_of(ReferenceBackend(), centred)
    sigma2 = (0.1 * focal / 2.0) ** 2 + 0.3
    # The pose may be turned a little; a round Gaussian stays round.
    assert float(seen.radius_px[0]) == pytest.approx(RADIUS_SIGMAS * sigma2**0.5, rel=0.05)


def test_what_nobody_sees_has_no_gradient_and_no_radius(make, change):
    case = make(count=20)
    means = case.scene.means.clone()
    means[:10, 2] = -3.0
    seen = statistics_of(CpuBackend(), change(case, means=means))
    for column in (seen.gradient_sum, seen.sightings, seen.radius_px, seen.mean_gradient()):
        assert not column[:10].any()
    assert seen.sightings[10:].any()


def test_without_a_record_the_gradients_are_the_same(make):
    case = make()
    grads = []
    for screen in (None, ScreenStatistics.empty(len(case.scene))):
        scene = case.scene.map(lambda tensor: tensor.clone().requires_grad_(True))
        backend = CpuBackend()
        backend.coded(scene, case.poses, case.intrinsics, backend.code(case.masks), screen).square().sum().backward()
        grads.append(scene.means.grad)
    assert torch.equal(*grads)


@pytest.mark.parametrize("name", ["cpu", "reference"])
def test_a_record_of_another_number_of_gaussians_is_refused(name, make):
    case, backend = make(), load_backend(name)
    with pytest.raises(InputError, match="screen statistics of 7 Gaussians"):
        backend.coded(case.scene, case.poses, case.intrinsics, backend.code(case.masks), ScreenStatistics.empty(7))
