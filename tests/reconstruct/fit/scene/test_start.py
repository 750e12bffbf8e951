import numpy as np
import pytest
import torch

from gs2ci.reconstruct.fit.scene.start import INITIAL_OPACITY, first_gaussians
from gs2ci.reconstruct.geometry.points import Seeds


def seeds(positions, channels=3, spacing=0.1):
    positions = np.asarray(positions, np.float32)
    colours = np.random.default_rng(0).random((len(positions), channels)).astype(np.float32)
    return Seeds(positions, colours, np.full(len(positions), spacing, np.float32))


def test_gaussians_stand_on_the_points_faint_and_round_with_their_colours():
    points = seeds(np.random.default_rng(1).random((50, 3)))
    scene = first_gaussians(points).check()
    np.testing.assert_array_equal(scene.means.numpy(), points.positions)
    np.testing.assert_array_equal(scene.colours.numpy(), points.colours)
    torch.testing.assert_close(torch.sigmoid(scene.opacity_logits), torch.full((50,), INITIAL_OPACITY))
    assert (scene.log_scales == scene.log_scales[:, :1]).all()
    assert (scene.quaternions == torch.tensor([1.0, 0, 0, 0])).all()


def test_each_is_seven_tenths_as_large_as_its_three_nearest_neighbours_are_far_on_average():
    grid = np.stack(np.meshgrid(np.arange(5), np.arange(5), [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    scene = first_gaussians(seeds(grid))
    sizes = scene.log_scales[:, 0].exp().reshape(5, 5)
    assert sizes[2, 2].item() == pytest.approx(0.7)
    assert sizes[0, 0].item() == pytest.approx(0.7 * (1 + 1 + np.sqrt(2)) / 3)


def test_points_in_one_place_have_a_small_and_finite_size():
    scene = first_gaussians(seeds(np.zeros((6, 3)), spacing=0.5)).check()
    torch.testing.assert_close(scene.log_scales.exp(), torch.full((6, 3), 0.05))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_fewer_points_than_neighbours_are_enough(count):
    scene = first_gaussians(seeds(np.arange(count)[:, None] * np.ones(3))).check()
    assert len(scene) == count


def test_a_mono_scene_gets_three_equal_channels():
    points = seeds(np.random.default_rng(1).random((10, 3)), channels=1)
    scene = first_gaussians(points).check()
    np.testing.assert_array_equal(scene.colours.numpy(), np.repeat(points.colours, 3, axis=1))


def test_the_scene_does_not_share_memory_with_the_points():
    points = seeds(np.random.default_rng(1).random((10, 3)))
    before = points.positions.copy(), points.colours.copy()
    scene = first_gaussians(points)
    scene.means.add_(1)
    scene.colours.add_(1)
    np.testing.assert_array_equal(points.positions, before[0])
    np.testing.assert_array_equal(points.colours, before[1])
