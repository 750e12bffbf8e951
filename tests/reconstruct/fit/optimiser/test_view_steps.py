import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import InputError
from gs2ci.reconstruct.fit.kernels.distances import FARTHEST
from gs2ci.reconstruct.fit.optimiser.adam import Adam
from gs2ci.reconstruct.fit.optimiser.gaussians import GaussianOptimiser, StepSizes
from gs2ci.reconstruct.fit.optimiser.view_steps import (
    ReferenceView,
    ViewAdam,
    ViewSteps,
    gradient_in_view,
    move_in_view,
)
from gs2ci.render.conventions import NEAR

FOCAL_PX, PATH = 200.0, 0.05
STEPS = ViewSteps(across_px=0.3, parallax_px=0.06, across_final_share=0.2, parallax_final_share=0.1)


def turned_view():
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.1, -0.3, 0.2]).as_matrix()
    pose[:3, 3] = 0.2, -0.1, 0.3
    return ReferenceView(pose, FOCAL_PX, PATH)


def scattered_ahead(view, count=50, seed=0):
    """Return centres at depths of 0.5 to 3 of a view, and log sizes, float64."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(0.5, 3, count)
    seen = np.stack([rng.uniform(-0.6, 0.6, count) * z, rng.uniform(-0.6, 0.6, count) * z, z], axis=1)
    means = (seen - view.pose[:3, 3]) @ view.pose[:3, :3]
    return means, rng.uniform(-4, -2, (count, 3))


def coordinates(means, view):
    """Return x/z, y/z and 1/z, [G, 3]."""
    x, y, z = (np.asarray(means, np.float64) @ view.pose[:3, :3].T + view.pose[:3, 3]).T
    return np.stack([x / z, y / z, 1 / z], axis=1)


def stepped(means, sizes, gradient, view, steps=STEPS, progress=0.0, by_sizes=None, damping=1.0):
    places, log_scales = torch.from_numpy(means).float(), torch.from_numpy(sizes).float()
    places.grad = torch.from_numpy(gradient).float()
    log_scales.grad = None if by_sizes is None else torch.from_numpy(by_sizes).float()
    ViewAdam(view, steps, Adam()).step(places, log_scales, progress, damping)
    return places.numpy(), log_scales.numpy()


@pytest.mark.parametrize("progress", [0.0, 0.5, 1.0])
def test_a_first_step_has_the_stated_length_in_pixels_wherever_a_gaussian_is(progress):
    view = turned_view()
    means, sizes = scattered_ahead(view)
    gradient = np.random.default_rng(1).normal(size=means.shape)
    moved, _ = stepped(means, sizes, gradient, view, progress=progress)
    change = np.abs(coordinates(moved, view) - coordinates(means, view))
    assert FOCAL_PX * change[:, :2] == pytest.approx(0.3 * 0.2**progress, rel=0.01)
    assert FOCAL_PX * PATH * change[:, 2] == pytest.approx(0.06 * 0.1**progress, rel=0.01)


def test_along_the_line_of_sight_a_gaussian_keeps_its_size_in_the_picture():
    view = turned_view()
    means, sizes = scattered_ahead(view)
    moved, scaled = stepped(means, sizes, np.random.default_rng(1).normal(size=means.shape), view)
    before, after = (np.exp(found) * coordinates(at, view)[:, 2:] for found, at in ((sizes, means), (scaled, moved)))
    np.testing.assert_allclose(after, before, rtol=1e-5)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_gradient_is_that_of_the_coordinates(dtype):
    """By differences, in float64, of an objective of places and sizes, with sizes in the picture held fixed."""
    view = turned_view()
    means, sizes = scattered_ahead(view, 7)
    rng = np.random.default_rng(2)
    by_means, by_sizes = rng.normal(size=means.shape), rng.normal(size=sizes.shape)

    def objective(q):
        z = 1 / q[:, 2]
        seen = np.stack([q[:, 0] * z, q[:, 1] * z, z], axis=1)
        at = (seen - view.pose[:3, 3]) @ view.pose[:3, :3]
        larger = np.log(z * coordinates(means, view)[:, 2])[:, None]
        return (by_means * at).sum() + (by_sizes * (sizes + larger)).sum()

    q, small = coordinates(means, view), 1e-6
    expected = np.empty_like(q)
    for g, k in np.ndindex(q.shape):
        aside = np.zeros_like(q)
        aside[g, k] = small
        expected[g, k] = (objective(q + aside) - objective(q - aside)) / (2 * small)
    found = np.empty(means.shape, dtype)
    gradient_in_view(means.astype(dtype), by_means.astype(dtype), by_sizes.astype(dtype), view.pose, NEAR, found)
    np.testing.assert_allclose(found, expected, rtol=1e-4 if dtype is np.float32 else 1e-6, atol=1e-5)


def test_float32_moves_as_float64_does():
    view = turned_view()
    means, sizes = scattered_ahead(view)
    steps = np.random.default_rng(3).normal(size=means.shape)
    found = []
    for dtype in (np.float32, np.float64):
        at, scaled = means.astype(dtype), sizes.astype(dtype)
        move_in_view(at, scaled, steps.astype(dtype), view.pose, NEAR, 1e-3, 5e-3)
        found.append((at, scaled))
    np.testing.assert_allclose(found[0][0], found[1][0], atol=1e-6)
    np.testing.assert_allclose(found[0][1], found[1][1], atol=1e-6)


def test_small_steps_are_not_lost_in_rounding():
    """A hundred steps of a thousandth of a pixel in float32 add up to a tenth of one."""
    view = turned_view()
    means, sizes = scattered_ahead(view)
    at, scaled = means.astype(np.float32), sizes.astype(np.float32)
    for _ in range(100):
        move_in_view(at, scaled, np.ones_like(at), view.pose, NEAR, 1e-3 / FOCAL_PX, 0.0)
    change = FOCAL_PX * (coordinates(at, view) - coordinates(means, view))[:, :2]
    assert change == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_distance_changes_by_at_most_a_quarter_in_one_step(sign):
    view = turned_view()
    means, sizes = scattered_ahead(view)
    far = means + 1e4 * view.pose[2, :3]
    at, scaled = far.copy(), sizes.copy()
    move_in_view(at, scaled, np.full(far.shape, float(sign)), view.pose, NEAR, 0.0, 1e3)
    ratio = coordinates(far, view)[:, 2] / coordinates(at, view)[:, 2]
    assert ratio == pytest.approx(1.25 if sign < 0 else 0.8)
    assert np.isfinite(scaled).all()


def test_what_is_drawn_towards_infinity_stops_at_the_bound():
    """Four hundred steps of a quarter each used to leave float32."""
    view = turned_view()
    means, sizes = (each.astype(np.float32) for each in scattered_ahead(view))
    for _ in range(1000):
        move_in_view(means, sizes, np.full(means.shape, -1.0, np.float32), view.pose, NEAR, 0.0, 1e3)
    assert 1 / coordinates(means, view)[:, 2] == pytest.approx(FARTHEST, rel=1e-3)
    assert np.isfinite(sizes).all()


def test_what_is_beyond_the_bound_stays_there_or_comes_nearer():
    view = turned_view()
    means, sizes = scattered_ahead(view)
    beyond = means + 3 * FARTHEST * view.pose[2, :3]
    for sign, ratio in ((-1.0, 1.0), (1.0, 0.8)):
        at, scaled = beyond.copy(), sizes.copy()
        move_in_view(at, scaled, np.full(at.shape, sign), view.pose, NEAR, 0.0, 1e3)
        assert coordinates(beyond, view)[:, 2] / coordinates(at, view)[:, 2] == pytest.approx(ratio)


def test_behind_the_view_and_at_its_centre_a_step_has_the_length_of_one_at_depth_one():
    view = turned_view()
    seen = np.array([[0.1, 0.2, -1.0], [0.0, 0.0, 0.0], [0.3, 0.0, NEAR]])
    means = (seen - view.pose[:3, 3]) @ view.pose[:3, :3]
    sizes = np.full((3, 3), -3.0)
    moved, scaled = stepped(means, sizes, np.random.default_rng(4).normal(size=(3, 3)), view)
    after = moved @ view.pose[:3, :3].T + view.pose[:3, 3]
    assert np.abs(after - seen) == pytest.approx(0.3 / FOCAL_PX, rel=0.01)
    np.testing.assert_allclose(scaled, sizes)


def test_without_a_gradient_nothing_moves():
    view = turned_view()
    means, sizes = (torch.from_numpy(each).float() for each in scattered_ahead(view))
    before = means.clone()
    ViewAdam(view, STEPS, Adam()).step(means, sizes, 0.0, 1.0)
    assert torch.equal(means, before)


def test_damping_shortens_the_step():
    view = turned_view()
    means, sizes = scattered_ahead(view)
    gradient = np.random.default_rng(1).normal(size=means.shape)
    whole, half = (
        coordinates(stepped(means, sizes, gradient, view, damping=damping)[0], view) - coordinates(means, view)
        for damping in (1.0, 0.5)
    )
    np.testing.assert_allclose(half, whole / 2, rtol=0.02, atol=1e-7)


def test_an_optimiser_steps_so_only_with_a_view_and_with_steps_for_it(scattered):
    view = turned_view()
    found = []
    for sizes, given in (
        (StepSizes(), view),
        (StepSizes(), None),
        (StepSizes(in_view=None), view),
    ):
        optimiser = GaussianOptimiser(scattered(6), sizes, 0.5, given)
        optimiser.scene.means.grad = torch.ones(6, 3)
        optimiser.step(0.0)
        found.append(optimiser.scene.means.detach())
    assert not torch.equal(found[0], found[1])
    assert torch.equal(found[1], found[2])


def test_moments_follow_their_gaussians(scattered):
    """A Gaussian that is continued keeps moving without a gradient; a new one stays."""
    optimiser = GaussianOptimiser(scattered(4), StepSizes(), 0.5, turned_view())
    optimiser.scene.means.grad = torch.ones(4, 3)
    optimiser.step(0.0)
    scene = optimiser.scene.map(lambda rows: rows.detach()[[1, 1]])
    optimiser.replace(scene, torch.tensor([1, -1]))
    before = optimiser.scene.means.detach().clone()
    optimiser.scene.means.grad = torch.zeros(2, 3)
    optimiser.step(0.0)
    moved = (optimiser.scene.means.detach() - before).abs().amax(dim=1)
    assert moved[0] > 0
    assert moved[1] == 0


def test_longer_strides_lengthen_both_steps():
    assert StepSizes.of_schedule(150).in_view == ViewSteps().times(2.0)
    assert StepSizes.of_the_literature().in_view is None


@pytest.mark.parametrize("change", [{"across_px": 0.0}, {"parallax_px": -1.0}, {"across_final_share": 1.5}])
def test_steps_out_of_bounds_are_refused(change):
    with pytest.raises(InputError, match=next(iter(change))):
        ViewSteps(**change).check()
