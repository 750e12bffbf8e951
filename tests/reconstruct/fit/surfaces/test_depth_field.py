"""Depths of whole regions: the field's gradient, what it moves, and what it is good for."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.interpolate import RegularGridInterpolator

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.fit.kernels.distances import FARTHEST
from gs2ci.reconstruct.fit.optimiser.adam import Adam
from gs2ci.reconstruct.fit.surfaces.depth_field import DepthField, DepthFieldSettings, FieldStep
from gs2ci.render.gaussians import Gaussians
from tests.render import se3

WIDEST = (0.5, 0.4)
SETTINGS = DepthFieldSettings(every=1)


@pytest.fixture
def scene():
    """Points before a camera that stands anywhere."""
    rng = np.random.default_rng(0)
    rays = np.concatenate([rng.uniform((-0.45, -0.35), (0.45, 0.35), (200, 2)), np.ones((200, 1))], axis=1)
    seen = rays / rng.uniform(0.4, 1.8, (200, 1))
    return Gaussians(
        means=torch.from_numpy(seen @ POSE[:3, :3] - POSE[:3, 3] @ POSE[:3, :3]),
        log_scales=torch.full((200, 3), -3.0, dtype=torch.float64),
        quaternions=torch.ones(200, 4, dtype=torch.float64),
        opacity_logits=torch.zeros(200, dtype=torch.float64),
        colours=torch.zeros(200, 3, dtype=torch.float64),
    )


POSE = se3.exp(torch.tensor([[0.1, -0.2, 0.05, 0.02, -0.03, 0.1]], dtype=torch.float64))[0].numpy()
GRID = np.array([-0.5, -0.4, 0.45]), np.array([0.2, 0.2, 0.4])


def field(values):
    """A step by a field, [A, B, C]."""
    return FieldStep(POSE, *GRID, np.asarray(values, np.float64))


def reference_view(scene):
    """Directions, [P, 2], and inverse depths, [P], of a scene's points."""
    seen = scene.means.numpy() @ POSE[:3, :3].T + POSE[:3, 3]
    return seen[:, :2] / seen[:, 2:], 1 / seen[:, 2]


def at_places(values, directions, inverse_depth):
    """The field by another's interpolation."""
    knots = [low + step * np.arange(count) for low, step, count in zip(*GRID, values.shape, strict=True)]
    ends = [(one[0], one[-1]) for one in knots]
    places = np.concatenate([directions, inverse_depth[:, None]], axis=1)
    return RegularGridInterpolator(knots, values)(np.clip(places, *np.transpose(ends)))


def test_a_field_is_added_to_the_inverse_depths_of_gaussians_along_their_rays(scene):
    values = 1e-4 * np.random.default_rng(1).normal(size=(6, 5, 4))
    directions, before = reference_view(scene)
    moved = scene.map(lambda tensor: tensor.clone())
    field(values).of_scene(moved)
    there, after = reference_view(moved)
    np.testing.assert_allclose(there, directions, atol=1e-12)
    # To first order.
    np.testing.assert_allclose(after - before, at_places(values, directions, before), atol=1e-6)
    np.testing.assert_allclose((moved.log_scales - scene.log_scales)[:, 0], np.log(before / after), atol=1e-6)


def test_a_map_of_another_view_moves_with_them():
    rng = np.random.default_rng(2)
    values = 1e-3 * rng.normal(size=(6, 5, 4))
    rays = rng.uniform((-0.4, -0.3), (0.4, 0.3), (7, 9, 2)).astype(np.float32)
    inverse_depth = rng.uniform(0.5, 1.5, (7, 9)).astype(np.float32)
    pose = se3.exp(torch.tensor([[0.05, 0.02, 0.0, 0.0, 0.02, 0.0]], dtype=torch.float64))[0].numpy() @ POSE
    before, pixels = inverse_depth.copy(), np.arange(0, 63, 2)
    field(values).of_map(*map(torch.from_numpy, (inverse_depth, pixels, rays)), pose)
    points = np.concatenate([rays, np.ones((7, 9, 1))], axis=2).reshape(-1, 3) / before.reshape(-1, 1)
    seen = np.concatenate([points, np.ones((63, 1))], axis=1) @ (POSE @ np.linalg.inv(pose)).T
    wanted = at_places(values, seen[:, :2] / seen[:, 2:3], 1 / seen[:, 2])
    wanted[np.setdiff1d(np.arange(63), pixels)] = 0
    np.testing.assert_allclose((inverse_depth - before).reshape(-1), wanted, atol=1e-6)


def test_the_gradient_is_the_objectives_derivative_by_each_knot(scene):
    weights = torch.from_numpy(np.random.default_rng(3).normal(size=(2, 200, 3)))

    def objective(scene):
        return (weights[0] * scene.means**2).sum() + (weights[1] * scene.log_scales).sum()

    leaf = scene.map(lambda tensor: tensor.clone().requires_grad_())
    objective(leaf).backward()
    depth_field = DepthField(SETTINGS, 0, WIDEST)
    step = depth_field.step(leaf, torch.from_numpy(POSE)[None], 0.0, 0)
    # The first step is the gradient by its root mean square and its own, against its sign.
    found = []
    for knot in ((1, 2, 0), (3, 2, 1), (4, 3, 2)):
        values = []
        for small in (-1e-5, 1e-5):
            bump = np.zeros_like(step.values)
            bump[knot] = small
            moved = scene.map(lambda tensor: tensor.clone())
            replace(step, values=bump).of_scene(moved)
            values.append(float(objective(moved)))
        along = -step.values[knot] / SETTINGS.rate
        assert 0 < abs(along) < 1
        found.append((values[1] - values[0]) / (along / (1 - along**2) ** 0.5))
    # g / sqrt(g^2 + m) for each, with the same m.
    assert found == pytest.approx([found[0]] * 3, rel=1e-4)


def test_a_region_that_surfaces_hold_at_a_wrong_depth_is_led_back_by_the_pictures_only_with_the_field(scene):
    """Surfaces at wrong depths draw each point more strongly than its own picture does."""
    path = torch.from_numpy(POSE).repeat(3, 1, 1)
    path[:, 0, 3] += torch.tensor([-0.1, 0.0, 0.1], dtype=torch.float64)

    def pictures(means):
        seen = torch.einsum("nij,pj->npi", path[:, :3, :3], means) + path[:, None, :3, 3]
        return seen[..., :2] / seen[..., 2:]

    truth, (directions, right) = pictures(scene.means), reference_view(scene)
    off = {}
    for with_field in (False, True):
        # Everything in the left half is too far away, and so say the surfaces.
        start = scene.map(lambda tensor: tensor.clone())
        field(np.broadcast_to(np.linspace(-0.06, 0.06, 6)[:, None, None] - 0.06, (6, 5, 4))).of_scene(start)
        leaf = start.map(lambda tensor: tensor.requires_grad_())
        surface = start.map(lambda tensor: tensor.detach().clone())
        depth_field, adam = DepthField(SETTINGS, 1, WIDEST), Adam()
        for iteration in range(200):
            (pictures(leaf.means) - truth).abs().mean().backward()
            leaf.log_scales.grad = torch.zeros_like(leaf.log_scales)
            step = depth_field.step(leaf, path, iteration / 200, iteration)
            (0.1 * (leaf.means - surface.means).abs().mean()).backward()
            adam.step(leaf.means, 1e-3)
            if with_field:
                step.of_scene(leaf)
                step.of_scene(surface)
            leaf.means.grad = None
        found = reference_view(leaf.detach())[1]
        off[with_field] = float(np.median(np.abs(found - right)[directions[:, 0] < 0]))
    assert off[False] > 0.05
    assert off[True] < 0.01


def test_what_was_forgotten_shortens_no_step(scene):
    leaf = scene.map(lambda tensor: tensor.clone().requires_grad_())
    poses, used, new = torch.from_numpy(POSE)[None], *(DepthField(SETTINGS, 0, WIDEST) for _ in range(2))
    (leaf.means.sum() + leaf.log_scales.sum()).backward()
    wanted = new.step(leaf, poses, 0.5, 0)
    gradient = leaf.means.grad.clone()
    leaf.means.grad *= 1e4
    used.step(leaf, poses, 0.5, 0)
    used.forget()
    leaf.means.grad = gradient
    np.testing.assert_array_equal(used.step(leaf, poses, 0.5, 1).values, wanted.values)


def test_nothing_moves_between_its_turns_or_by_a_gradient_that_is_not_finite(scene):
    leaf = scene.map(lambda tensor: tensor.clone().requires_grad_())
    poses, depth_field = torch.from_numpy(POSE)[None], DepthField(DepthFieldSettings(every=3), 0, WIDEST)
    assert depth_field.step(leaf, poses, 0.5, 0) is None
    (leaf.means.sum() + leaf.log_scales.sum()).backward()
    assert depth_field.step(leaf, poses, 0.5, 4) is None
    assert depth_field.step(leaf, poses, 0.5, 6) is not None
    leaf.means.grad[3, 1] = float("nan")
    assert depth_field.step(leaf, poses, 0.5, 9) is None


def test_what_stands_far_off_or_behind_stays_finite(scene):
    scene.means[0] *= 1e6
    scene.means[1] = torch.from_numpy(np.linalg.inv(POSE)[:3] @ [0.1, 0.1, -2.0, 1.0])
    for value in (0.5, -0.5):
        moved = scene.map(lambda tensor: tensor.clone())
        field(np.full((6, 5, 4), value)).of_scene(moved)
        assert torch.isfinite(moved.means).all()
        assert (reference_view(moved)[1][2:] > 0).all()
        np.testing.assert_array_equal(moved.means[1], scene.means[1])


def test_a_field_drives_nothing_farther_than_the_bound(scene):
    """Half a thousand steps of a quarter each would leave float32."""
    moved = scene.map(lambda tensor: tensor.float())
    for _ in range(500):
        field(np.full((6, 5, 4), -1e3)).of_scene(moved)
    assert 1 / reference_view(moved)[1] == pytest.approx(FARTHEST, rel=1e-3)
    assert torch.isfinite(moved.log_scales).all()


@pytest.mark.parametrize(
    "wrong", [{"rate": 0.0}, {"rate": float("nan")}, {"final_rate": -1.0}, {"every": 0}, {"deep": 1}]
)
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(InputError, match=f"{next(iter(wrong))} = .* in DepthFieldSettings"):
        replace(DepthFieldSettings(), **wrong).check()
