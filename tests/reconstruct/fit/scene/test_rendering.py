from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.reconstruct.fit.scene.mask_moments import MaskMoments
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.measurement import coding
from gs2ci.reconstruct.measurement.coding import Coding
from gs2ci.render.cpu.backend import CpuBackend
from tests.reconstruct.fit.scene.test_rigid import poses_of_the_graph
from tests.render import se3


@pytest.fixture
def renderer(moving_plane):
    shot, geometry = moving_plane
    return lambda given=shot: ShotRenderer(given, geometry.intrinsics, CpuBackend())


def test_the_measurement_is_the_coded_sum_of_the_views(moving_plane, renderer, scattered):
    shot, geometry = moving_plane
    scene, poses = scattered(200), torch.from_numpy(geometry.world_to_camera).float()
    views = renderer().views(scene, poses)
    coded = Coding.of(shot).forward(torch.from_numpy(views))
    torch.testing.assert_close(renderer().measurement(scene, poses), coded, atol=2e-5, rtol=1e-5)


def test_a_mono_sensor_and_a_mosaic_see_one_channel(moving_plane, renderer, scattered):
    shot, geometry = moving_plane
    scene, poses = scattered(200), torch.from_numpy(geometry.world_to_camera).float()
    colour = renderer().measurement(scene, poses)
    mono = replace(shot, measurement=shot.measurement[..., :1])
    torch.testing.assert_close(renderer(mono).measurement(scene, poses), colour.mean(2, keepdim=True))
    assert renderer(mono).views(scene, poses).shape == (4, 32, 40, 1)
    mosaic = renderer(replace(mono, cfa="RGGB"))
    assert mosaic.views(scene, poses).shape == (4, 32, 40, 3)
    np.testing.assert_array_equal(mosaic.measurement(scene, poses)[0::2, 0::2, 0], colour[0::2, 0::2, 0])
    np.testing.assert_array_equal(mosaic.measurement(scene, poses)[1::2, 1::2, 0], colour[1::2, 1::2, 2])


@pytest.mark.parametrize("sensor", ["colour", "mono", "mosaic", "moments", "moving"])
def test_the_gradient_by_a_call_is_that_of_the_graph(moving_plane, renderer, scattered, sensor):
    shot, geometry = moving_plane
    scene, poses = scattered(60), torch.from_numpy(geometry.world_to_camera).float()
    if sensor in ("mono", "mosaic"):
        shot = replace(shot, measurement=shot.measurement[..., :1], cfa="RGGB" if sensor == "mosaic" else "")
    moments = MaskMoments((2,) * 4, (0.8,) * 4) if sensor == "moments" else None
    if sensor == "moving":
        scene = replace(scene, motion=torch.full((60, 2, 3), 0.01))
    one = ShotRenderer(shot, geometry.intrinsics, CpuBackend(), mask_moments=moments)
    ours, theirs = (scene.map(lambda tensor: tensor.clone().requires_grad_()) for _ in range(2))
    leaf = poses.clone().requires_grad_()
    expected = measured_by_the_graph(one, theirs, leaf)
    weights = torch.randn(expected.shape, generator=torch.Generator().manual_seed(4))
    expected.backward(weights)
    image, pull = one.measurement_with_pull(ours, poses)
    torch.testing.assert_close(torch.from_numpy(image), expected.detach(), rtol=1e-6, atol=1e-6)
    by_poses = torch.from_numpy(pull(weights.numpy()))
    if sensor == "moments":  # along rigid motions, which alone matter
        by_poses, expected_by = (_by_twists(poses, gradient) for gradient in (by_poses, leaf.grad))
        torch.testing.assert_close(by_poses, expected_by, rtol=1e-4, atol=1e-4)
    else:
        torch.testing.assert_close(by_poses, leaf.grad, rtol=1e-5, atol=1e-5)
    for name, tensor in theirs.parameters().items():
        torch.testing.assert_close(ours.parameters()[name].grad, tensor.grad, rtol=1e-5, atol=1e-5)


def measured_by_the_graph(renderer, scene, path):
    """Render the coded measurement, [H, W, C]; differentiable."""
    moments, times = renderer._mask_moments, renderer.times
    if moments is not None:
        path, times = poses_of_the_graph(moments, path), moments.times
    backend, given = renderer._backend, (renderer.intrinsics, renderer._mask_set)
    image = backend.coded(scene, path, *given, times=times)
    if renderer.shot.cfa:
        return coding.select(image, renderer._channels)
    return image.mean(dim=2, keepdim=True) if renderer.shot.channels == 1 else image


def _by_twists(poses, gradient):
    twists = torch.zeros(len(poses), 6, requires_grad=True)
    return torch.autograd.grad((se3.exp(twists) @ poses * gradient).sum(), twists)[0]


def test_depth_is_that_of_the_surface_along_the_axis(moving_plane, renderer, scattered):
    """Opaque Gaussians on a plane at depth 2, seen by a camera that has come half a unit closer."""
    _, geometry = moving_plane
    y, x = np.mgrid[-1:1:40j, -1.2:1.2:48j]
    wall = scattered(x.size, logits=8.0)
    wall = replace(
        wall,
        means=torch.tensor(np.stack([x.ravel(), y.ravel(), np.full(x.size, 2.0)], axis=1), dtype=torch.float32),
        log_scales=torch.full((x.size, 3), float(np.log(0.04))),
    )
    poses = geometry.world_to_camera[:2].copy()
    poses[1] = np.eye(4)
    poses[1, 2, 3] = -0.5
    depths = renderer().depths(wall, poses)
    assert depths[1, 10:22, 12:28] == pytest.approx(1.5, abs=0.03)


def test_some_depths_are_those_of_squares_of_pixels(moving_plane, renderer, scattered):
    scene, poses, whole_picture = scattered(2000, logits=2.0), moving_plane[1].world_to_camera[:1], renderer()
    rows, columns = (np.flatnonzero(np.arange(side) // 4 % 4 == 0) for side in whole_picture.size)
    whole = whole_picture.depths(scene, poses)
    some = whole_picture.stopped_light(scene, poses, some=True).surface().numpy()
    assert (some > 0).any()
    np.testing.assert_allclose(some, whole[:, rows][:, :, columns], rtol=1e-4)


def walls(scattered, *alphas_at):
    """Walls that fill the frame, one Gaussian each so wide that it is even: pairs of its alpha and its depth."""
    alphas, depths = (torch.tensor(column, dtype=torch.float32) for column in zip(*alphas_at, strict=True))
    return replace(
        scattered(len(alphas)),
        means=torch.stack([torch.zeros(len(depths)), torch.zeros(len(depths)), depths], dim=1),
        log_scales=torch.log(depths.abs()[:, None] * torch.tensor([20.0, 20.0, 1e-3])),
        quaternions=torch.tensor([[1.0, 0, 0, 0]]).repeat(len(depths), 1),
        opacity_logits=torch.logit(alphas),
    )


@pytest.mark.parametrize(
    ("alphas_at", "depth"),
    [
        ([(0.8, 2.0), (0.9, 50.0)], 2.0),  # the mean is 9.3
        ([(0.1, 0.5), (0.9, 4.0)], 4.0),  # a veil before a wall; the mean is 3.6
        ([(0.3, 1.0), (0.5, 2.0), (0.9, 9.0)], 2.0),  # 0.3, 0.35 and 0.315 of the light
        ([(0.3, 9.0), (0.5, 2.0), (0.9, 1.0)], 1.0),  # in any order
        ([(0.6, 3.0)], 3.0),
    ],
)
def test_depth_is_where_half_of_what_is_stopped_is_stopped(moving_plane, renderer, scattered, alphas_at, depth):
    """Against the weights α ∏ (1 − α) worked out by hand; the walls are a thousandth as thick as they are far."""
    depths = renderer().depths(walls(scattered, *alphas_at), np.eye(4)[None])
    assert depths.shape == (1, 32, 40)
    assert depths[0, 8:24, 10:30] == pytest.approx(depth, rel=3e-3)


def test_a_depth_in_fog_is_where_half_of_the_light_is_gone(moving_plane, renderer, scattered):
    """A thousand Gaussians one behind the other: alphas of 0.002 stop half of their 0.865 at the 283rd."""
    at = np.linspace(2.0, 4.0, 1000)
    depths = renderer().depths(walls(scattered, *((0.002 + 1 / 255, z) for z in at)), np.eye(4)[None])
    alpha = 0.002 + 1 / 255
    stopped = np.cumsum(alpha * (1 - alpha) ** np.arange(1000))
    expected = at[np.searchsorted(stopped, stopped[-1] / 2)]
    assert depths[0, 8:24, 10:30] == pytest.approx(expected, rel=5e-3)


def test_what_lies_behind_a_camera_has_no_depth(moving_plane, renderer, scattered):
    both = walls(scattered, (0.9, -2.0), (0.9, 3.0))
    assert renderer().depths(both, np.eye(4)[None])[0, 8:24, 10:30] == pytest.approx(3.0, rel=3e-3)
    turned = np.diag([-1.0, 1, -1, 1])[None]
    assert not renderer().depths(walls(scattered, (0.9, 3.0)), turned).any()


def test_depth_is_zero_where_less_than_half_of_the_light_is_stopped(moving_plane, renderer, scattered):
    _, geometry = moving_plane
    assert not renderer().depths(scattered(3, logits=-6.0), geometry.world_to_camera).any()


@pytest.mark.parametrize("sensor", ["colour", "mosaic"])
def test_one_picture_for_all_masks_is_what_each_of_them_sees_from_one_pose(moving_plane, scattered, sensor):
    shot, geometry = moving_plane
    if sensor == "mosaic":
        shot = replace(shot, measurement=shot.measurement[..., :1], cfa="RGGB")
    shot = replace(shot, weights=np.array([1, 0.5, 0.8, 1.2], np.float32))
    scene = scattered(60)
    poses = torch.from_numpy(geometry.world_to_camera[1]).float().repeat(4, 1, 1)
    each, once = (
        ShotRenderer(shot, geometry.intrinsics, CpuBackend(), one_picture=one_picture) for one_picture in (False, True)
    )
    torch.testing.assert_close(once.measurement(scene, poses), each.measurement(scene, poses), rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(once.exposed(scene, poses), each.exposed(scene, poses), rtol=1e-6, atol=1e-6)
    ours, theirs = (scene.map(lambda tensor: tensor.clone().requires_grad_()) for _ in range(2))
    (image, pull), (_, pull_each) = (
        one.measurement_with_pull(own, poses) for one, own in ((once, ours), (each, theirs))
    )
    gradient = np.random.default_rng(4).standard_normal(image.shape).astype(np.float32)
    assert not pull(gradient).any()
    pull_each(gradient)
    for name, tensor in theirs.parameters().items():
        torch.testing.assert_close(ours.parameters()[name].grad, tensor.grad, rtol=1e-4, atol=1e-4)
    assert once.split_transmissions.shape[0] == 1
    assert (each.moments_per_mask, once.moments_per_mask) == (1, 0.25)
    assert once.with_one_moment().moments_per_mask == 0.25
