from dataclasses import replace

import pytest
import torch

from gs2ci.reconstruct.fit.optimiser.gaussians import GaussianOptimiser, StepSizes

NAMES = ("means", "log_scales", "quaternions", "opacity_logits", "colours")
EXTENT = 0.5


def push(optimiser, seed=0):
    """Give every parameter a gradient that depends on nothing but the seed and the Gaussian's index."""
    draw = torch.Generator().manual_seed(seed)
    for tensor in optimiser.scene.parameters().values():
        tensor.grad = torch.randn(tensor.shape, generator=draw)


def pushed(scene, steps, sizes=None):
    optimiser = GaussianOptimiser(scene, sizes or StepSizes(), EXTENT)
    for i in range(steps):
        push(optimiser, i)
        optimiser.step(i / 10)
    return optimiser


@pytest.mark.parametrize("momentum", [0.9, 0.7])
def test_it_is_plain_adam_while_the_population_stays(scattered, momentum):
    scene, sizes = scattered(7), StepSizes(momentum=momentum)
    optimiser = pushed(scene, 5, sizes)
    plain = {name: tensor.clone() for name, tensor in scene.parameters().items()}
    rates = {name: getattr(sizes, name) for name in NAMES}
    groups = [{"params": [plain[name]], "lr": rates[name]} for name in NAMES]
    adam = torch.optim.Adam(groups, betas=(momentum, 0.999), eps=1e-15)
    for i in range(5):
        draw = torch.Generator().manual_seed(i)
        adam.param_groups[0]["lr"] = sizes.means * EXTENT * sizes.means_final_share ** (i / 10)
        for name in NAMES:
            plain[name].grad = torch.randn(plain[name].shape, generator=draw)
        adam.step()
    for name in NAMES:
        torch.testing.assert_close(getattr(optimiser.scene, name).detach(), plain[name], rtol=1e-5, atol=1e-7)


def test_the_mean_gradient_lags_behind_by_fewer_iterations_where_steps_are_longer():
    assert StepSizes.of_schedule(150).momentum == pytest.approx(0.8)
    assert StepSizes.of_schedule(600).momentum == StepSizes.of_the_literature().momentum == 0.9


def test_a_step_clears_the_gradients_and_leaves_the_given_scene_alone(scattered):
    scene = scattered(4)
    before = scene.map(torch.clone)
    optimiser = pushed(scene, 1)
    for name in NAMES:
        assert getattr(optimiser.scene, name).grad is None
        assert torch.equal(getattr(scene, name), getattr(before, name))


def test_damping_shortens_every_step(scattered):
    scene = scattered(4)
    moved = {}
    for damping in (1.0, 0.5):
        optimiser = GaussianOptimiser(scene, StepSizes(), EXTENT)
        push(optimiser)
        optimiser.step(0.0, damping)
        moved[damping] = {name: getattr(optimiser.scene, name).detach() - getattr(scene, name) for name in NAMES}
    for name in NAMES:
        torch.testing.assert_close(moved[0.5][name], 0.5 * moved[1.0][name], rtol=1e-2, atol=1e-7)


def test_gaussians_keep_their_moments_when_others_come_and_go(scattered):
    scene = scattered(6)
    undisturbed, changed = pushed(scene, 3), pushed(scene, 3)
    stay = torch.tensor([4, 1, 5])
    continued = changed.scene.map(lambda tensor: tensor.detach()[stay])
    newcomers = scattered(2, seed=1)
    joined = type(scene)(**{name: torch.cat([getattr(continued, name), getattr(newcomers, name)]) for name in NAMES})
    changed.replace(joined, torch.tensor([4, 1, 5, -1, -1]))
    assert len(changed.scene) == 5

    gradients = {name: torch.randn_like(getattr(scene, name)) for name in NAMES}
    for name in NAMES:
        getattr(undisturbed.scene, name).grad = gradients[name]
        getattr(changed.scene, name).grad = torch.cat([gradients[name][stay], torch.ones_like(gradients[name][:2])])
    undisturbed.step(0.5)
    changed.step(0.5)
    for name in NAMES:
        torch.testing.assert_close(
            getattr(changed.scene, name).detach()[:3], getattr(undisturbed.scene, name).detach()[stay], rtol=0, atol=0
        )


def test_newcomers_start_without_moments(scattered):
    """Without a gradient a newcomer stays put, where one with a history would coast."""
    optimiser = pushed(scattered(3), 3)
    scene = optimiser.scene.detach()
    optimiser.replace(scene, torch.tensor([0, -1, 2]))
    for tensor in optimiser.scene.parameters().values():
        tensor.grad = torch.zeros_like(tensor)
    optimiser.step(0.0)
    for name in NAMES:
        moved = (getattr(optimiser.scene, name).detach() != getattr(scene, name)).reshape(3, -1).any(dim=1)
        assert moved.tolist() == [True, False, True], name


def test_a_population_may_be_replaced_before_the_first_step(scattered):
    optimiser = GaussianOptimiser(scattered(3), StepSizes(), EXTENT)
    optimiser.replace(scattered(5), torch.tensor([0, 1, 2, -1, -1]))
    push(optimiser)
    optimiser.step(0.0)
    assert len(optimiser.scene) == 5


def test_restoring_forgets_where_the_moments_led(scattered):
    scene = scattered(4)
    optimiser = pushed(scene, 5)
    optimiser.restore(scene)
    fresh = GaussianOptimiser(scene, StepSizes(), EXTENT)
    for each in (optimiser, fresh):
        push(each, 9)
        each.step(0.2)
    for name in NAMES:
        assert torch.equal(getattr(optimiser.scene, name), getattr(fresh.scene, name))


def test_a_restored_snapshot_is_not_changed_by_later_steps(scattered):
    scene = scattered(4)
    before = scene.map(torch.clone)
    optimiser = pushed(scattered(4, seed=1), 1)
    optimiser.restore(scene)
    push(optimiser)
    optimiser.step(0.0)
    assert torch.equal(scene.means, before.means)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_one_bad_number_makes_the_gradient_not_finite(scattered, bad):
    optimiser = GaussianOptimiser(scattered(4), StepSizes(), EXTENT)
    assert optimiser.gradient_is_finite()
    push(optimiser)
    assert optimiser.gradient_is_finite()
    optimiser.scene.colours.grad[2, 1] = bad
    assert not optimiser.gradient_is_finite()


def test_large_finite_gradients_whose_sum_overflows_are_finite(scattered):
    optimiser = GaussianOptimiser(scattered(4), StepSizes(), EXTENT)
    optimiser.scene.means.grad = torch.full((4, 3), 3e38)
    assert optimiser.gradient_is_finite()


@pytest.mark.parametrize("size", [3e38, 1e-12, 1e-38])
def test_gradients_of_any_size_move_the_parameters_by_bounded_steps(scattered, size):
    scene = scattered(4)
    optimiser = GaussianOptimiser(scene, StepSizes(), EXTENT)
    for _ in range(20):
        for tensor in optimiser.scene.parameters().values():
            tensor.grad = torch.full_like(tensor, size)
        optimiser.step(0.0)
    for name in NAMES:
        moved = (getattr(optimiser.scene, name).detach() - getattr(scene, name)).abs()
        assert torch.isfinite(moved).all()
        assert moved.max() <= 20 * 1.01 * getattr(StepSizes(), name)


def test_an_empty_scene_can_be_stepped_replaced_and_restored(scattered):
    empty = scattered(0)
    optimiser = pushed(empty, 2)
    optimiser.replace(empty, torch.zeros(0, dtype=torch.int64))
    push(optimiser)
    optimiser.step(0.5)
    optimiser.restore(empty)
    assert optimiser.gradient_is_finite()
    assert len(optimiser.scene) == 0


def test_an_empty_scene_can_take_newcomers(scattered):
    optimiser = pushed(scattered(0), 1)
    optimiser.replace(scattered(2), torch.tensor([-1, -1]))
    push(optimiser)
    optimiser.step(0.0)
    assert len(optimiser.scene) == 2


def test_a_shift_moves_the_means_alone_and_leaves_the_moments(scattered):
    moves = torch.linspace(-1, 1, 12).reshape(4, 3)
    shifted, plain = pushed(scattered(4), 2), pushed(scattered(4), 2)
    shifted.shift(moves)
    torch.testing.assert_close(shifted.scene.means.detach(), plain.scene.means.detach() + moves)
    for optimiser in (shifted, plain):
        push(optimiser, 9)
        optimiser.step(0.2)
    torch.testing.assert_close(shifted.scene.means.detach(), plain.scene.means.detach() + moves, rtol=1e-5, atol=1e-6)


def test_forgetting_a_parameter_lets_it_start_anew_and_no_other(scattered):
    optimisers = {}
    for forget in (frozenset(), frozenset({"opacity_logits"})):
        optimiser = optimisers[bool(forget)] = pushed(scattered(4), 3)
        optimiser.replace(optimiser.scene.detach(), torch.arange(4), forget)
        push(optimiser, 9)
        optimiser.step(0.3)
    for name in NAMES:
        same = torch.equal(getattr(optimisers[True].scene, name), getattr(optimisers[False].scene, name))
        assert same == (name != "opacity_logits")


@pytest.mark.parametrize("progress", [0.0, 0.5, 1.0])
def test_the_means_rate_is_the_one_that_a_step_takes(scattered, progress):
    optimiser = GaussianOptimiser(scattered(4), StepSizes(), EXTENT)
    before = optimiser.scene.means.detach().clone()
    push(optimiser)
    optimiser.step(progress, 0.5)
    longest = float((optimiser.scene.means.detach() - before).abs().max())
    # Adam's first step is its rate, whatever the gradient.
    assert longest == pytest.approx(optimiser.means_rate(progress, 0.5), rel=1e-3)


@pytest.mark.parametrize("focal_px", [50.0, 200.0])
def test_motion_steps_in_pixels_however_far_the_camera_went(scattered, focal_px):
    scene = scattered(4)
    scene = replace(scene, motion=torch.zeros(len(scene), 2, 3))
    optimiser = GaussianOptimiser(scene, StepSizes(motion_px=0.3), EXTENT, px_per_length=focal_px)
    push(optimiser)
    optimiser.step(0.0)
    assert float(optimiser.scene.motion.detach().abs().max()) * focal_px == pytest.approx(0.3, rel=1e-3)
