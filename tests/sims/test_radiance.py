import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gs2ci.core.errors import InputError
from gs2ci_sims.path import StageMove
from gs2ci_sims.radiance import VIEWS_AT_ONCE, Renderer, rendered_depth
from gs2ci_sims.scene import Scene

POSES = StageMove((0.1, 0.05, 0.0)).world_to_camera(np.linspace(-1, 1, VIEWS_AT_ONCE + 3))


def test_views_do_not_depend_on_how_many_are_asked_for_at_once(small_scene):
    radiance, coverage = Renderer().views(small_scene, POSES)
    for index in (0, VIEWS_AT_ONCE, len(POSES) - 1):
        one, covered = Renderer().views(small_scene, POSES[index : index + 1])
        np.testing.assert_allclose(one[0], radiance[index], atol=1e-6)
        np.testing.assert_allclose(covered[0], coverage[index], atol=1e-6)


def test_radiance_and_coverage_are_in_range(small_scene):
    radiance, coverage = Renderer().views(small_scene, POSES)
    assert radiance.min() >= 0
    assert radiance.max() <= 1 + 1e-5
    assert coverage.min() > 0.99
    assert coverage.max() <= 1 + 1e-6


def test_negative_colours_of_a_fitted_scene_send_no_negative_light(small_scene):
    gaussians = small_scene.gaussians.map(torch.clone)
    gaussians.colours -= 0.5
    dark = Scene("dark", gaussians, small_scene.intrinsics, small_scene.size, small_scene.depth)
    radiance, _ = Renderer().views(dark, POSES[:1])
    assert radiance.min() == 0
    assert radiance.max() > 0


def test_supersampling_converges_on_the_pixels_area_average(small_scene):
    coarse, medium, fine = (Renderer(factor).views(small_scene, POSES[:1])[0] for factor in (1, 2, 4))
    assert np.abs(medium - fine).mean() < 0.5 * np.abs(coarse - fine).mean()


def test_rendering_needs_at_least_one_sample_per_pixel():
    with pytest.raises(InputError, match="supersampling = 0"):
        Renderer(0)


def test_rendered_depth_is_that_of_the_surfaces_and_nan_where_nothing_is(small_scene):
    depth = rendered_depth(small_scene.gaussians, np.eye(4), small_scene.intrinsics, small_scene.size)
    error = np.abs(depth - small_scene.depth) / small_scene.depth
    assert np.nanmedian(error) < 0.002
    assert np.nanmean(error > 0.05) < 0.15  # rims, where a pixel sees both sides
    away = np.diag([1.0, -1.0, -1.0, 1.0])
    behind = rendered_depth(small_scene.gaussians, away, small_scene.intrinsics, small_scene.size)
    assert np.isnan(behind).all()


def test_harmonics_make_colours_depend_on_the_direction_of_sight(small_scene):
    harmonics = torch.zeros(len(small_scene.gaussians), 3, 3)
    harmonics[:, 2] = 0.3  # along x, with a negative sign
    shiny = dataclasses.replace(small_scene, gaussians=dataclasses.replace(small_scene.gaussians, harmonics=harmonics))
    turns = ([0, -0.3, 0], [0, 0.3, 0], [0, 0, 0.5])  # to the right, to the left, about the line of sight
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
    change = Renderer().views(shiny, poses)[0].astype(float) - Renderer().views(small_scene, poses)[0]
    assert change[0].mean() < -0.02
    assert change[1].mean() > 0.02
    assert abs(change[2].mean()) < 0.01
