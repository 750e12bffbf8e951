"""The exchange of turning for travel: what it leaves of the views, its gradient, and what it is good for."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.fit.kernels.distances import FARTHEST
from gs2ci.reconstruct.fit.optimiser.adam import Adam
from gs2ci.reconstruct.fit.optimiser.relief import Exchange, Relief, ReliefSettings, relief_step
from gs2ci.render import se3
from gs2ci.render.gaussians import Gaussians

REFERENCE = 2


def points_at(directions, depth):
    """Gaussians at depths along directions (u, v, 1)."""
    rays = np.concatenate([directions, np.ones((len(depth), 1))], axis=1)
    count = len(depth)
    return Gaussians(
        means=torch.tensor(rays * depth[:, None], dtype=torch.float64),
        log_scales=torch.full((count, 3), -3.0, dtype=torch.float64),
        quaternions=torch.ones(count, 4, dtype=torch.float64),
        opacity_logits=torch.zeros(count, dtype=torch.float64),
        colours=torch.zeros(count, 3, dtype=torch.float64),
    )


@pytest.fixture
def scene():
    rng = np.random.default_rng(0)
    return points_at(rng.uniform((-0.45, -0.35), (0.45, 0.35), (60, 2)), 1 / rng.uniform(0.4, 1.8, 60))


@pytest.fixture
def path():
    """Five cameras along a slanted line, the third at the origin."""
    poses = torch.eye(4, dtype=torch.float64).repeat(5, 1, 1)
    poses[:, :3, 3] = torch.linspace(-0.1, 0.1, 5, dtype=torch.float64)[:, None] * torch.tensor([1.0, 0.3, 0.1])
    return poses


def projected(means, poses):
    """(u, v) of points in every view, [N, P, 2]."""
    seen = torch.einsum("nij,pj->npi", poses[:, :3, :3], means) + poses[:, None, :3, 3]
    return seen[..., :2] / seen[..., 2:]


def exchanged(scene, poses, beta, steps=1):
    """Scene and poses after an exchange by `beta` in all."""
    scene = scene.map(lambda tensor: tensor.detach().clone())
    for _ in range(steps):
        exchange = Exchange(relief_step(scene, poses, REFERENCE), beta / steps)
        exchange.of_scene(scene)
        poses = se3.exp(exchange.twists) @ poses
    return scene, poses


def shift_across(scene, poses, moved):
    """What an exchange changes of the views, (u, v), along the path and across it, [N, P]."""
    change = projected(moved[0].means, moved[1]) - projected(scene.means, poses)
    way = torch.tensor([1.0, 0.3], dtype=torch.float64) / 1.09**0.5
    return change @ way, change @ torch.stack([-way[1], way[0]])


def test_an_exchange_leaves_the_views_as_they_were_but_for_a_shift_across_the_path_at_the_rims(scene, path):
    # Little parallax: what a view sees elsewhere than the reference is of second order.
    beta, path = 0.02, path.clone()
    path[:, :3, 3] *= torch.tensor([0.1, 0.1, 0.0])
    along, across = shift_across(scene, path, exchanged(scene, path, beta))
    # The same inverse depth added without turning anything.
    nearer = scene.map(lambda tensor: tensor.clone())
    nearer.means = scene.means / (1 + beta * scene.means[:, 2:])
    alone, _ = shift_across(scene, path, (nearer, path))
    assert alone.abs().max() > 1.8e-4
    assert along.abs().max() < 0.1 * alone.abs().max()
    travel = path[:, None, :2, 3] @ torch.tensor([1.0, 0.3], dtype=torch.float64) / 1.09**0.5
    directions = scene.means[:, :2] / scene.means[:, 2:]
    way = torch.tensor([1.0, 0.3], dtype=torch.float64) / 1.09**0.5
    expected = -beta * travel * (directions @ way) * (directions @ torch.stack([-way[1], way[0]]))
    np.testing.assert_allclose(across.numpy(), expected.numpy(), atol=0.2 * float(expected.abs().max()))


def test_the_reference_camera_and_the_median_depth_stay(scene, path):
    moved, poses = exchanged(scene, path, 0.2, steps=20)
    np.testing.assert_allclose(poses[REFERENCE].numpy(), np.eye(4), atol=1e-12)
    before, after = (float(one.means[:, 2].median()) for one in (scene, moved))
    assert after == pytest.approx(before, rel=0.05)
    # Sizes on screen stay, as the distances change.
    ratio = moved.means[:, 2] / scene.means[:, 2]
    np.testing.assert_allclose((moved.log_scales - scene.log_scales)[:, 0], ratio.log(), atol=0.01)


def test_the_gradient_is_the_objectives_derivative_along_the_exchange(scene, path):
    draw = np.random.default_rng(1)
    weights = [torch.from_numpy(draw.normal(size=shape)) for shape in ((5, 60, 2), (60, 3))]

    def objective(means, log_scales, poses):
        return (weights[0] * projected(means, poses)).sum() + (weights[1] * log_scales).sum()

    leaf = scene.map(lambda tensor: tensor.clone().requires_grad_())
    twists = torch.zeros(5, 6, dtype=torch.float64, requires_grad=True)
    objective(leaf.means, leaf.log_scales, se3.exp(twists) @ path).backward()
    relief = Relief(ReliefSettings(begins=0.0), REFERENCE)
    # Adam's first step is its rate, against the gradient's sign; the gradient itself is told by differences.
    exchange = relief.step(leaf, path, twists.grad, 0.0)
    small = 1e-5
    values = []
    for beta in (-small, small):
        moved, poses = exchanged(scene, path, beta)
        values.append(float(objective(moved.means, moved.log_scales, poses)))
    slope = (values[1] - values[0]) / (2 * small)
    along = relief_step(scene, path, REFERENCE)
    told = (leaf.means.grad * along.means).sum() + (leaf.log_scales.grad.sum(1) * along.log_sizes).sum()
    told = told + (twists.grad * along.twists).sum()
    assert float(told) == pytest.approx(slope, rel=1e-6)
    assert exchange.beta == pytest.approx(-ReliefSettings().rate * np.sign(slope), rel=1e-6)
    assert relief.moved == exchange.beta


@pytest.mark.parametrize("wrong", [-0.3, 0.3])
def test_points_and_cameras_that_step_one_by_one_find_the_depth_only_with_exchanges(scene, path, wrong):
    """A turned path and depths to match are led back to the truth by the pictures alone."""
    truth = projected(scene.means, path)
    depth = scene.means[:, 2]
    off = {}
    for with_exchange in (False, True):
        start, poses = exchanged(scene, path, wrong, steps=30)
        leaf = start.map(lambda tensor: tensor.clone().requires_grad_())
        twists = torch.zeros(5, 6, dtype=torch.float64, requires_grad=True)
        relief, adams = Relief(ReliefSettings(begins=0.0), REFERENCE), (Adam(), Adam())
        for iteration in range(250):
            share = iteration / 250
            now = se3.exp(twists) @ poses
            (projected(leaf.means, now) - truth).abs().mean().backward()
            exchange = relief.step(leaf, now.detach(), twists.grad, share)
            adams[0].step(leaf.means, 2e-3 * 0.2**share)
            adams[1].step(twists, 3e-3 * 0.002**share)
            if with_exchange:
                exchange.of_scene(leaf)
                with torch.no_grad():
                    twists.add_(exchange.twists)
            leaf.means.grad = twists.grad = None
        found = leaf.means.detach()[:, 2]
        found = found * (depth / found).median()
        off[with_exchange] = float((found / depth - 1).abs().median())
    assert off[False] > 0.05
    assert off[True] < 0.5 * off[False]
    assert off[True] < 0.04


def test_what_was_forgotten_shortens_no_step(scene, path):
    leaf = scene.map(lambda tensor: tensor.clone().requires_grad_())
    leaf.means.sum().backward()
    none = torch.zeros(5, 6, dtype=torch.float64)
    wanted = Relief(ReliefSettings(), REFERENCE).step(leaf, path, none, 0.5).beta
    relief = Relief(ReliefSettings(), REFERENCE)
    leaf.means.grad *= 1e4
    relief.step(leaf, path, none, 0.5)
    leaf.means.grad /= 1e4
    assert abs(relief.step(leaf, path, none, 0.5).beta) != pytest.approx(abs(wanted), rel=0.1)
    relief.forget()
    assert relief.step(leaf, path, none, 0.5).beta == pytest.approx(wanted)


def test_nothing_is_exchanged_before_it_is_time_or_by_a_gradient_that_is_not_finite(scene, path):
    leaf = scene.map(lambda tensor: tensor.clone().requires_grad_())
    leaf.means.sum().backward()
    relief, none = Relief(ReliefSettings(begins=0.5), REFERENCE), torch.zeros(5, 6, dtype=torch.float64)
    assert relief.step(leaf, path, none, 0.49) is None
    assert relief.step(leaf, path, none * float("nan"), 0.5) is None
    assert relief.moved == 0
    assert relief.step(leaf, path, none, 0.5).beta != 0


def test_nothing_is_exchanged_where_the_camera_goes_forward(scene):
    leaf = scene.map(lambda tensor: tensor.clone().requires_grad_())
    leaf.means[:, 2].sum().backward()
    relief, none = Relief(ReliefSettings(begins=0.0), REFERENCE), torch.zeros(5, 6, dtype=torch.float64)
    for way, exchanges in (((0.5, 0.2, 1.0), False), ((1.0, 0.3, 0.6), True), ((0.0, 0.0, 0.0), False)):
        poses = torch.eye(4, dtype=torch.float64).repeat(5, 1, 1)
        poses[:, :3, 3] = torch.linspace(-0.1, 0.1, 5, dtype=torch.float64)[:, None] * torch.tensor(way)
        assert (relief.step(leaf, poses, none, 0.0) is not None) == exchanges


def test_what_stands_far_off_or_behind_stays_finite(path):
    directions = np.array([[0.0, 0.0], [0.4, 0.3], [-0.2, 0.1], [0.1, 0.1]])
    scene = points_at(directions, np.array([1.0, 1e6, 1.2, 0.9]))
    scene.means[3] *= -1
    for beta in (0.05, -0.05):
        moved, poses = exchanged(scene, path, beta, steps=40)
        assert torch.isfinite(moved.means).all()
        assert torch.isfinite(poses).all()
        assert moved.means[1, 2] > 1
    still = torch.eye(4, dtype=torch.float64).repeat(5, 1, 1)
    moved, poses = exchanged(scene, still, 0.05)
    assert torch.isfinite(moved.means).all()
    np.testing.assert_array_equal(poses, still)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("distance", "most"), [(0.9, 1.0), (3.0, 3.0)])
def test_an_exchange_drives_nothing_farther_than_the_bound(path, distance, most, dtype):
    scene = points_at(np.array([[0.0, 0.0], [0.0, 0.0], [0.1, 0.0]]), np.array([1.0, distance * FARTHEST, 1.2]))
    scene = scene.map(lambda tensor: tensor.to(dtype))
    moved, _ = exchanged(scene, path, -0.05)
    assert moved.means[1, 2] == pytest.approx(most * FARTHEST)


@pytest.mark.parametrize("wrong", [{"rate": 0.0}, {"rate": float("nan")}, {"final_rate": -1.0}, {"begins": 1.0}])
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(InputError, match=f"{next(iter(wrong))} = .* in ReliefSettings"):
        replace(ReliefSettings(), **wrong).check()
