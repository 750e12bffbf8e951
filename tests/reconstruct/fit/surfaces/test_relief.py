"""The exchange of turning for travel: what it leaves of the views, its gradient, and what it is good for."""

import numpy as np
import pytest
import torch

from gs2ci.reconstruct.fit.optimiser.adam import Adam
from gs2ci.reconstruct.fit.surfaces.depth_field import DepthField, DepthFieldSettings, FieldStep, Relief, direction
from gs2ci.render.gaussians import Gaussians
from tests.render import se3

REFERENCE = 2
WIDEST = (0.5, 0.4)
SETTINGS = {on: DepthFieldSettings(every=1, **({} if on else {"exchange": None})) for on in (False, True)}
# Knots of a field that reaches from the farthest to the nearest point of the scene below, whose mean is its median.
LOW, BETWEEN = np.array([-0.5, -0.4, 0.4]), np.array([0.2, 0.2, 1.4 / 3])
KNOTS = tuple(low + step * np.arange(count) for low, step, count in zip(LOW, BETWEEN, (6, 5, 4), strict=True))


@pytest.fixture
def scene():
    rng = np.random.default_rng(0)
    rays = np.concatenate([rng.uniform((-0.45, -0.35), (0.45, 0.35), (60, 2)), np.ones((60, 1))], axis=1)
    return Gaussians(
        means=torch.from_numpy(rays / rng.uniform(0.4, 1.8, (60, 1))),
        log_scales=torch.full((60, 3), -3.0, dtype=torch.float64),
        quaternions=torch.ones(60, 4, dtype=torch.float64),
        opacity_logits=torch.zeros(60, dtype=torch.float64),
        colours=torch.zeros(60, 3, dtype=torch.float64),
    )


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


def travel_of(poses):
    return (poses.numpy() @ np.linalg.inv(poses[REFERENCE].numpy()))[:, :3, 3]


def exchanged(scene, poses, beta, steps=1):
    """Scene and poses after an exchange by `beta` in all."""
    scene = scene.map(lambda tensor: tensor.detach().clone())
    for _ in range(steps):
        values, twists = direction(KNOTS, travel_of(poses))
        FieldStep(poses[REFERENCE].numpy(), LOW, BETWEEN, beta / steps * values).of_scene(scene)
        poses = se3.exp(beta / steps * torch.from_numpy(twists)) @ poses
    return scene, poses


def test_an_exchange_leaves_the_views_as_they_were_but_for_a_shift_across_the_path_at_the_rims(scene, path):
    # Little parallax: what a view sees elsewhere than the reference is of second order.
    beta, path = 0.02, path.clone()
    path[:, :3, 3] *= torch.tensor([0.1, 0.1, 0.0])
    way = torch.tensor([1.0, 0.3], dtype=torch.float64) / 1.09**0.5
    aside = torch.stack([-way[1], way[0]])
    moved, poses = exchanged(scene, path, beta)
    # Larger or smaller as a whole, together with its path, a scene looks the same.
    change = projected(moved.means, poses) - projected(scene.means, path)
    nearer = scene.means / (1 + beta * scene.means[:, 2:])
    alone = (projected(nearer, path) - projected(scene.means, path)) @ way
    assert alone.abs().max() > 1.8e-4
    assert (change @ way).abs().max() < 0.15 * alone.abs().max()
    directions = scene.means[:, :2] / scene.means[:, 2:]
    expected = -beta * (path[:, None, :2, 3] @ way) * (directions @ way) * (directions @ aside)
    np.testing.assert_allclose((change @ aside).numpy(), expected.numpy(), atol=0.25 * float(expected.abs().max()))


def test_the_reference_camera_stays_and_the_depth_of_the_middle_hardly_changes(scene, path):
    moved, poses = exchanged(scene, path, 0.2, steps=20)
    np.testing.assert_allclose(poses[REFERENCE].numpy(), np.eye(4), atol=1e-12)
    before, after = (float(one.means[:, 2].median()) for one in (scene, moved))
    assert after == pytest.approx(before, rel=0.05)
    spread = [float((1 / one.means[:, 2]).std()) for one in (scene, moved)]
    assert spread[1] == pytest.approx(spread[0] * np.exp(-0.2 / 1.1), rel=0.05)


def test_its_first_step_is_as_long_as_its_rate_against_the_objectives_derivative_along_it(scene, path):
    draw = np.random.default_rng(1)
    weights = [torch.from_numpy(draw.normal(size=shape)) for shape in ((5, 60, 2), (60, 3))]

    def objective(means, log_scales, poses):
        return (weights[0] * projected(means, poses)).sum() + (weights[1] * log_scales).sum()

    leaf = scene.map(lambda tensor: tensor.clone().requires_grad_())
    twists = torch.zeros(5, 6, dtype=torch.float64, requires_grad=True)
    objective(leaf.means, leaf.log_scales, se3.exp(twists) @ path).backward()
    steps = {}
    for exchanges in (False, True):
        field = DepthField(SETTINGS[exchanges], REFERENCE, WIDEST)
        steps[exchanges] = field.step(leaf, path, 0.0, 0, twists.grad)
    added, low, between = steps[True].values - steps[False].values, steps[True].low, steps[True].between
    knots = tuple(at + apart * np.arange(count) for at, apart, count in zip(low, between, added.shape, strict=True))
    values, by_twists = direction(knots, travel_of(path))
    beta = float((added * values).sum() / (values**2).sum())
    assert abs(beta) == pytest.approx(SETTINGS[True].exchange)
    np.testing.assert_allclose(added, beta * values, atol=1e-12)
    np.testing.assert_allclose(steps[True].twists, beta * by_twists, atol=1e-12)
    told = []
    for small in (-1e-5, 1e-5):
        moved = scene.map(lambda tensor: tensor.clone())
        FieldStep(steps[True].pose, low, between, small * values).of_scene(moved)
        poses = se3.exp(small * torch.from_numpy(by_twists)) @ path
        told.append(float(objective(moved.means, moved.log_scales, poses)))
    assert np.sign(beta) == -np.sign(told[1] - told[0])


@pytest.mark.parametrize("wrong", [-0.3, 0.3])
def test_points_and_cameras_that_step_one_by_one_find_the_depth_only_with_exchanges(scene, path, wrong):
    """A turned path and depths to match are led back to the truth by the pictures alone."""
    truth, depth = projected(scene.means, path), scene.means[:, 2]
    off = {}
    for exchanges in (False, True):
        start, poses = exchanged(scene, path, wrong, steps=30)
        leaf = start.map(lambda tensor: tensor.clone().requires_grad_())
        twists = torch.zeros(5, 6, dtype=torch.float64, requires_grad=True)
        field = DepthField(SETTINGS[exchanges], REFERENCE, WIDEST)
        adams = (Adam(), Adam())
        for iteration in range(250):
            share = iteration / 250
            now = se3.exp(twists) @ poses
            (projected(leaf.means, now) - truth).abs().mean().backward()
            leaf.log_scales.grad = torch.zeros_like(leaf.log_scales)
            step = field.step(leaf, now.detach(), share, iteration, twists.grad)
            adams[0].step(leaf.means, 2e-3 * 0.2**share)
            adams[1].step(twists, 3e-3 * 0.002**share)
            step.of_scene(leaf)
            if step.twists is not None:
                with torch.no_grad():
                    twists.add_(step.twists)
            leaf.means.grad = twists.grad = None
        found = leaf.means.detach()[:, 2]
        off[exchanges] = float((found * (depth / found).median() / depth - 1).abs().median())
    assert off[True] < 0.5 * off[False]
    assert off[True] < 0.04


def test_nothing_is_exchanged_where_the_camera_goes_forward_or_by_a_gradient_that_is_not_finite(path):
    by_knots, by_twists = np.ones((6, 5, 4)), torch.zeros(5, 6)
    for way, exchanges in (((0.5, 0.2, 1.0), False), ((1.0, 0.3, 0.6), True), ((0.0, 0.0, 0.0), False)):
        travel = np.linspace(-0.1, 0.1, 5)[:, None] * np.array(way)
        assert (Relief().step(by_knots, by_twists, KNOTS, travel, 0.01) is not None) == exchanges
    assert Relief().step(by_knots, by_twists * float("nan"), KNOTS, travel_of(path), 0.01) is None
