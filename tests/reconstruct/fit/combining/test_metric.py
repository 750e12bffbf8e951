from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.reconstruct.fit.coarse.stage import CoarseFit
from gs2ci.reconstruct.fit.combining.ensemble import Ensemble
from gs2ci.reconstruct.fit.combining.metric import in_given_unit
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.render.backend import load_backend
from gs2ci.render.gaussians import Gaussians
from gs2ci.render.settings import RasterSettings

SIZE = (24, 32)
INTRINSICS = np.array([[30.0, 0, 16], [0, 30.0, 12], [0, 0, 1]])


@pytest.fixture
def ensemble():
    draw = torch.Generator().manual_seed(0)
    scene = Gaussians(
        means=torch.randn((40, 3), generator=draw) * torch.tensor([0.5, 0.4, 0.2]) + torch.tensor([0, 0, 1.0]),
        log_scales=torch.randn((40, 3), generator=draw) * 0.2 - 2.5,
        quaternions=torch.randn((40, 4), generator=draw),
        opacity_logits=torch.randn(40, generator=draw),
        colours=torch.rand((40, 3), generator=draw),
    )
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = (-0.02, 0.0, 0.02)
    return Ensemble(
        CoarseFit(scene, poses, np.zeros((3, *SIZE, 3), np.float32), (), "done", (), np.eye(3)), np.zeros(0)
    )


def geometry(unit, poses):
    flat = np.ones(SIZE, np.float32)
    return Geometry(poses, INTRINSICS, "file", flat, 1, 99, 0.5, 2.0, "full", (), "stage", unit=unit)


def rendered(fit, times=None):
    backend = load_backend("cpu", RasterSettings())
    poses = torch.from_numpy(fit.world_to_camera).float()
    return backend.views(fit.scene, poses, torch.from_numpy(INTRINSICS).float(), SIZE, times=times)[0].numpy()


@pytest.mark.parametrize("unit", [0.3, 640.0])
def test_all_lengths_grow_alike_and_the_views_stay(ensemble, unit):
    before = ensemble.best
    measured, after = in_given_unit(geometry(unit, before.world_to_camera), ensemble)
    np.testing.assert_allclose(after.best.world_to_camera[:, 0, 3], unit * np.array([-0.02, 0.0, 0.02]))
    np.testing.assert_allclose(measured.world_to_camera, after.best.world_to_camera)
    np.testing.assert_allclose(measured.inverse_depth * unit, 1.0, rtol=1e-6)
    np.testing.assert_allclose(after.best.scene.means, unit * before.scene.means, rtol=1e-6)
    np.testing.assert_allclose(rendered(after.best), rendered(before), atol=2e-4)
    assert measured.unit == unit


def test_a_path_that_shrank_in_the_fit_is_as_long_as_the_given_one_again(ensemble):
    given = ensemble.best.world_to_camera.copy()
    given[:, :3, 3] *= 1.25
    _, after = in_given_unit(geometry(10.0, given), ensemble)
    np.testing.assert_allclose(after.best.world_to_camera[:, 0, 3], (-0.25, 0.0, 0.25))
    np.testing.assert_allclose(after.best.scene.means, 12.5 * ensemble.best.scene.means, rtol=1e-6)


@pytest.mark.parametrize("path", [0.0, 1e-300])
def test_a_fit_whose_cameras_came_to_rest_in_one_place_has_no_unit(ensemble, path):
    moving = ensemble.best.world_to_camera.copy()
    ensemble.best.world_to_camera[:, :3, 3] *= path
    measured, after = in_given_unit(geometry(10.0, moving), ensemble)
    assert after is ensemble
    assert measured.unit is None


@pytest.mark.parametrize("unit", [None, 0.05, 1e6, np.inf])
def test_without_a_unit_that_can_be_rendered_nothing_changes_and_nothing_is_claimed(ensemble, unit):
    measured, after = in_given_unit(geometry(unit, ensemble.best.world_to_camera), ensemble)
    assert after is ensemble
    assert measured.unit is None


@pytest.mark.parametrize("moves", [False, True])
def test_gaussians_that_a_fit_drove_far_away_look_the_same_in_any_unit(ensemble, moves):
    """Their sizes are beyond what renderers draw: cut at one length, they would be smaller in a larger unit."""
    scene = ensemble.best.scene
    away = torch.logspace(2, 12, 40)
    sizes = (0.05 * away).log()[:, None].expand(-1, 3) + 0.2 * scene.log_scales
    directions = scene.means * torch.tensor([0.5, 0.5, 0]) + torch.tensor([0, 0, 1.0])
    motion = 0.05 * away[:, None, None] * torch.tensor([[1.0, 0.3, 0]]) if moves else None
    far = replace(scene, means=away[:, None] * directions, log_scales=sizes, motion=motion)
    fits = replace(ensemble, best=replace(ensemble.best, scene=far))
    _, after = in_given_unit(geometry(640.0, ensemble.best.world_to_camera), fits)
    times = torch.tensor([-1.0, 0.0, 1.0])
    before, shown = (rendered(fit, times) for fit in (fits.best, after.best))
    assert before.max() > 0.2
    np.testing.assert_allclose(shown, before, atol=5e-3)
    assert after.best.scene.means.norm(dim=1).max() < 640 * 3e5
    order = torch.argsort(far.means[:, 2])
    assert bool((after.best.scene.means[order, 2].diff() > 0).all())
