"""A shot's renderer behind a lens shows the sensor's images."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.lens import distorted, pixels_of
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.measurement.coding import Coding
from gs2ci.reconstruct.measurement.lens import Lens
from gs2ci.render.cpu.backend import CpuBackend

DISTORTION = np.array([-0.3, 0.02, 0, 0, 0])


@pytest.fixture
def bent(moving_plane):
    shot, geometry = moving_plane
    return replace(shot, intrinsics=geometry.intrinsics, distortion=DISTORTION).check(), geometry


def test_a_small_gaussian_appears_where_the_lens_bends_its_ray(bent, scattered):
    shot, geometry = bent
    scene = scattered(1, logits=5.0)
    point = np.array([-0.5, -0.4, 2.0])
    scene = replace(
        scene,
        means=torch.tensor(point, dtype=torch.float32)[None],
        log_scales=torch.full((1, 3), -4.0),
        colours=torch.ones(1, 3),
    )
    image, _ = ShotRenderer(shot, geometry.intrinsics, CpuBackend(), Lens.of(shot)).images(scene, torch.eye(4)[None])
    light = image[0, ..., 0].numpy()
    rows, columns = np.mgrid[: shot.size[0], : shot.size[1]] + 0.5
    centre = np.array([(columns * light).sum(), (rows * light).sum()]) / light.sum()
    expected = pixels_of(distorted(point[:2] / point[2], DISTORTION), geometry.intrinsics)
    straight = pixels_of(point[:2] / point[2], geometry.intrinsics)
    np.testing.assert_allclose(centre, expected, atol=0.05)
    assert np.linalg.norm(straight - expected) > 0.3


def test_measurement_views_and_depth_are_the_sensors(bent, scattered):
    shot, geometry = bent
    renderer = ShotRenderer(shot, geometry.intrinsics, CpuBackend(), Lens.of(shot))
    scene, poses = scattered(200), torch.from_numpy(geometry.world_to_camera).float()
    views = renderer.views(scene, poses)
    assert views.shape[:3] == (shot.views, *shot.size)
    coded = Coding.of(shot).forward(torch.from_numpy(views))
    torch.testing.assert_close(renderer.measurement(scene, poses, renderer.reuse()), coded, atol=2e-5, rtol=1e-5)
    assert renderer.depths(scene, geometry.world_to_camera).shape == views.shape[:3]
    assert renderer.distortion is shot.distortion
