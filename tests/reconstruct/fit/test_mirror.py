"""A fitted scene turned inside out, against its definition in float64."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gs2ci.reconstruct.fit.mirror import inside_out
from gs2ci.render.gaussians import Gaussians, rotation_matrices

C = 2.0
REFERENCE = 2
# Gaussians are kept in float32.
CLOSE = {"rtol": 2e-5, "atol": 2e-6}


@pytest.fixture
def scene():
    draw = torch.Generator().manual_seed(0)
    count = 50
    depth = 0.75 + 1.5 * torch.rand(count, generator=draw)
    aside = (torch.rand(count, 2, generator=draw) - 0.5) * depth[:, None]
    return Gaussians(
        means=torch.cat([aside, depth[:, None]], dim=1),
        log_scales=torch.log(0.002 + 0.05 * torch.rand(count, 3, generator=draw)),
        quaternions=torch.randn(count, 4, generator=draw),
        opacity_logits=torch.randn(count, generator=draw),
        colours=torch.rand(count, 3, generator=draw),
    )


@pytest.fixture
def path():
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(np.linspace([-0.02, 0.01, 0], [0.01, -0.005, 0], 4)).as_matrix()
    poses[:, :3, 3] = np.linspace([-0.04, 0, 0.01], [0.02, 0.01, 0], 4)
    return poses @ np.linalg.inv(poses[REFERENCE])


def covariances(scene):
    axes = rotation_matrices(scene.quaternions.double()) * scene.log_scales.double().exp()[:, None, :]
    return (axes @ axes.transpose(1, 2)).numpy()


def reflected(points):
    """Reflect inverse depth at C / 2, along each ray."""
    return points / (C * points[..., 2:] - 1)


def test_centres_go_along_their_rays_to_the_reflected_inverse_depth(scene, path):
    turned, _ = inside_out(scene, path, REFERENCE, C)
    np.testing.assert_allclose(turned.means, reflected(scene.means.double()).numpy(), **CLOSE)
    np.testing.assert_allclose(1 / turned.means[:, 2], C - 1 / scene.means[:, 2], **CLOSE)
    assert turned.opacity_logits.equal(scene.opacity_logits)
    assert turned.colours.equal(scene.colours)


def test_covariances_go_through_the_derivative_of_that_map(scene, path):
    turned, _ = inside_out(scene, path, REFERENCE, C)
    means, step = scene.means.double(), 1e-5
    columns = [(reflected(means + step * e) - reflected(means - step * e)) / (2 * step) for e in torch.eye(3).double()]
    derivative = torch.stack(columns, dim=2).numpy()
    wanted = derivative @ covariances(scene) @ derivative.transpose(0, 2, 1)
    np.testing.assert_allclose(covariances(turned), wanted, rtol=1e-4, atol=1e-7)


def test_a_surface_that_slants_away_slants_towards_the_camera(path):
    disc = Gaussians(
        means=torch.tensor([[0.0, 0.0, 1.0]]),
        log_scales=torch.log(torch.tensor([[0.1, 0.1, 0.001]])),
        quaternions=torch.tensor([[np.cos(0.3), 0.0, np.sin(0.3), 0.0]], dtype=torch.float32),
        opacity_logits=torch.zeros(1),
        colours=torch.zeros(1, 3),
    )
    before, after = covariances(disc)[0], covariances(inside_out(disc, path, REFERENCE, C)[0])[0]
    assert before[0, 2] * after[0, 2] < 0
    assert after[0, 2] == pytest.approx(-before[0, 2], rel=1e-3)


def test_twice_is_the_scene_itself(scene, path):
    again, poses = inside_out(*inside_out(scene, path, REFERENCE, C), REFERENCE, C)
    np.testing.assert_allclose(again.means, scene.means, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(covariances(again), covariances(scene), rtol=1e-3, atol=1e-6)
    # The turns that make up for the reversal meet those of the path in another order: exact to the second order.
    np.testing.assert_allclose(poses, path, atol=2e-3)


def test_the_reference_view_stays_wherever_the_world_lies(scene, path):
    elsewhere = np.eye(4)
    elsewhere[:3, :3] = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
    elsewhere[:3, 3] = (1.0, -2.0, 0.5)
    there = torch.from_numpy(elsewhere)
    moved = scene.map(torch.clone)
    moved.means = (scene.means.double() @ there[:3, :3].T + there[:3, 3]).float()
    moved.quaternions = torch.from_numpy(
        Rotation.from_matrix(there[:3, :3].numpy() @ rotation_matrices(scene.quaternions.double()).numpy()).as_quat(
            scalar_first=True
        )
    ).float()
    seen, poses = inside_out(moved, path @ np.linalg.inv(elsewhere), REFERENCE, C)
    turned, own = inside_out(scene, path, REFERENCE, C)
    np.testing.assert_allclose(poses, own @ np.linalg.inv(elsewhere), atol=1e-12)
    np.testing.assert_allclose(poses[REFERENCE] @ elsewhere, np.eye(4), atol=1e-12)
    back = (seen.means.double() - there[:3, 3]) @ there[:3, :3]
    np.testing.assert_allclose(back, turned.means, rtol=1e-4, atol=1e-5)


def test_what_would_lie_behind_the_camera_lies_far_away(scene, path):
    """Nearer than half the median depth, behind the camera, and of no rotation."""
    scene.means[0, 2], scene.means[1, 2], scene.quaternions[2] = 0.3, -1.0, 0.0
    turned, _ = inside_out(scene, path, REFERENCE, C)
    turned.check()
    assert turned.means[0, 2] == pytest.approx(20.0, rel=1e-4)
