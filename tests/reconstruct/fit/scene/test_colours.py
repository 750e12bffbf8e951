"""Colours that change with the direction of sight: when they may, how they step, and what they are good for."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from gs2ci.api.overrides import Overrides, settings_of
from gs2ci.core.errors import InputError
from gs2ci.reconstruct.fit.coarse.exposure import FittedExposure
from gs2ci.reconstruct.fit.coarse.looks import Monitoring
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut
from gs2ci.reconstruct.fit.density.base import grow
from gs2ci.reconstruct.fit.optimiser.gaussians import GaussianOptimiser, StepSizes
from gs2ci.reconstruct.fit.scene.colours import ColourSettings
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.paper.preset import paper_settings
from gs2ci.render.backend import load_backend
from gs2ci.render.harmonics import degree_of
from tests.reconstruct.fit.plane_fits import fit_coarse


def push(optimiser, seed):
    draw = torch.Generator().manual_seed(seed)
    for tensor in optimiser.scene.parameters().values():
        tensor.grad = torch.randn(tensor.shape, generator=draw)


def test_a_degree_comes_in_after_each_share_of_the_schedule():
    settings = ColourSettings(degree=2, every=0.25)
    assert [settings.at(share) for share in (0.0, 0.249, 0.25, 0.5, 0.75, 1.0)] == [0, 0, 1, 2, 2, 2]


def test_the_paper_lets_degrees_in_as_its_trainer_does():
    """nerfstudio, `models/splatfacto.py`: `min(step // sh_degree_interval, sh_degree)`, with 1,000 and 3."""
    fit = paper_settings().fit
    for step in (0, 999, 1000, 1001, 1999, 2000, 2999, 3000, 3001, 7000, 19_999):
        assert fit.colours.at(step / fit.iterations) == min(step // 1000, 3)


def test_the_paper_steps_coefficients_as_its_trainer_does():
    """There 0.0025 for the constant harmonic and a twentieth for the others; a colour is 0.28209479 times the first."""
    steps = paper_settings().fit.steps
    assert steps.colours == pytest.approx(0.0025 * 0.28209479)
    assert steps.harmonics == pytest.approx(0.0025 / 20)


@pytest.mark.parametrize("wrong", [{"degree": -1}, {"degree": 4}, {"every": 0.0}, {"every": 1.5}])
def test_settings_out_of_range_are_refused(wrong):
    with pytest.raises(InputError, match=f"{next(iter(wrong))} = .* in ColourSettings"):
        CoarseSettings(colours=ColourSettings(**wrong)).check()


def test_a_user_chooses_the_degree_and_the_preset_the_rest():
    assert settings_of("paper", Overrides(sh_degree=0)).fit.colours == replace(paper_settings().fit.colours, degree=0)
    assert settings_of("standard", Overrides(sh_degree=2)).fit.colours.degree == 2
    with pytest.raises(InputError, match="--sh-degree 5"):
        settings_of("draft", Overrides(sh_degree=5))


def test_new_harmonics_begin_at_zero_and_the_others_go_on_as_they_were(scattered):
    optimiser, untouched = (GaussianOptimiser(scattered(5), StepSizes(), 1.0) for _ in range(2))
    optimiser.let_colours_vary(1)
    assert optimiser.scene.harmonics.shape == (5, 3, 3)
    assert not optimiser.scene.harmonics.any()
    for step in range(4):
        for one in (optimiser, untouched):
            push(one, step)
            one.step(0.0)
    before = optimiser.scene.harmonics.detach().clone()
    optimiser.let_colours_vary(3)
    optimiser.let_colours_vary(2)
    assert torch.equal(optimiser.scene.harmonics[:, :3], before)
    assert not optimiser.scene.harmonics[:, 3:].any()
    assert optimiser.scene.harmonics.requires_grad
    for name in ("means", "colours"):
        assert torch.equal(getattr(optimiser.scene, name), getattr(untouched.scene, name))


def test_moments_of_what_was_there_go_on_and_those_of_what_comes_begin_at_zero(scattered):
    """Against plain Adam that had all columns from the beginning, with gradients of zero."""
    optimiser = GaussianOptimiser(scattered(4), StepSizes(), 1.0)
    optimiser.let_colours_vary(1)
    whole = torch.zeros(4, 8, 3, requires_grad=True)
    adam = torch.optim.Adam([whole], lr=StepSizes().harmonics, eps=1e-15)
    draw = torch.Generator().manual_seed(0)
    for step in range(8):
        if step == 4:
            optimiser.let_colours_vary(2)
        own = optimiser.scene.harmonics
        gradient = torch.zeros(4, 8, 3)
        gradient[:, : own.shape[1]] = torch.randn(own.shape, generator=draw)
        own.grad, whole.grad = gradient[:, : own.shape[1]].clone(), gradient
        optimiser.step(0.0)
        adam.step()
    torch.testing.assert_close(optimiser.scene.harmonics, whole, rtol=1e-4, atol=1e-8)


def test_copies_and_children_keep_the_harmonics_of_the_one_they_come_from(scattered):
    scene = scattered(3)
    scene.harmonics = torch.randn(3, 8, 3, generator=torch.Generator().manual_seed(1))
    first, second, third = torch.eye(3, dtype=torch.bool)
    grown = grow(scene, first | second, second, third, torch.Generator().manual_seed(0)).scene
    assert torch.equal(grown.harmonics, scene.harmonics[[0, 1, 1, 2, 2]])


def fitted(scene, shot, geometry, degree):
    settings = CoarseSettings(
        iterations=40,
        densify_from=1.0,
        surfaces=None,
        # Short steps of all that is right already.
        steps=replace(StepSizes.of_the_literature(), harmonics=2e-2),
        colours=ColourSettings(degree, every=0.1),
        hold_out=HoldOut(share=0.05, look_every=10),
    )
    settings = replace(settings, poses=replace(settings.poses, refine=False))
    holdout = Holdout.of(shot, settings.hold_out.share, 0)
    renderer = ShotRenderer(shot, geometry.intrinsics, load_backend())
    fit = fit_coarse(FittedExposure(holdout, renderer, geometry), scene, settings, 0, Monitoring())
    return fit, holdout.residual_rms(fit.views)


def test_a_fit_shows_colours_that_change_with_the_place_of_the_camera_and_finds_how(moving_plane, scattered):
    """A scene with harmonics of degree 1 on a wide arc of cameras, from its own Gaussians without them."""
    plane, geometry = moving_plane
    scene = scattered(300, logits=2.0)
    truth = replace(scene, harmonics=0.4 * torch.randn(300, 3, 3, generator=torch.Generator().manual_seed(4)))
    poses = np.tile(np.eye(4), (plane.views, 1, 1))
    for pose, angle in zip(poses, np.linspace(-0.6, 0.6, plane.views), strict=True):
        pose[:3, :3] = Rotation.from_rotvec([0, angle, 0]).as_matrix()
        pose[:3, 3] = np.array([0, 0, 1.5]) - pose[:3, :3] @ [0, 0, 1]
    at = torch.from_numpy(poses).float()
    views = load_backend().views(truth, at, torch.from_numpy(geometry.intrinsics).float(), plane.size)[0].numpy()
    shot = replace(plane, measurement=(plane.masks[..., None] * views).sum(axis=0)).check()
    geometry = replace(geometry, world_to_camera=poses)
    (dull, worse), (shiny, better) = (fitted(scene, shot, geometry, degree) for degree in (0, 1))
    assert [degree_of(fit.scene) for fit in (dull, shiny)] == [0, 1]
    assert better < 0.7 * worse, (better, worse)
    found = torch.corrcoef(torch.stack([shiny.scene.harmonics.flatten(), truth.harmonics.flatten()]))[0, 1]
    # Of 2700 coefficients, many of Gaussians that others hide; by chance it would be 0.02.
    assert found > 0.2, found
