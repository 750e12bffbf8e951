from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.reconstruct.fit.rendering import ShotRenderer
from gs2ci.reconstruct.measurement.coding import Coding
from gs2ci.render.cpu.backend import CpuBackend


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


def test_depth_is_zero_where_less_than_half_of_the_light_is_stopped(moving_plane, renderer, scattered):
    _, geometry = moving_plane
    assert not renderer().depths(scattered(3, logits=-6.0), geometry.world_to_camera).any()
