"""The exact renderer behind the interface of renderers, and the plan that chooses between them."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci_sims.effects.motion_blur import MotionBlur
from gs2ci_sims.effects.views import Defocus
from gs2ci_sims.exact import ExactRenderer, rendering_error
from gs2ci_sims.exposure import integrate
from gs2ci_sims.light_path import EffectChain
from gs2ci_sims.masks import random_masks
from gs2ci_sims.path import StageMove, stage_move_for_parallax
from gs2ci_sims.planner import plan
from gs2ci_sims.preview import preview
from gs2ci_sims.radiance import Renderer
from gs2ci_sims.rig import ModulatorFigures, RigFigures, Timing
from gs2ci_sims.scenes.planes import planes
from gs2ci_sims.simulation_plan import PlanChoice, SimulationTask
from tests.exposing import expose
from tests.sims.brute_force import deviation_dn, simulate_everything

SIZE = (24, 32)
RIG = RigFigures(modulator=ModulatorFigures(masks=2), timing=Timing(0.02))
STILL = StageMove((0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def scene():
    return planes(np.random.default_rng(12), SIZE)


@pytest.fixture(scope="module")
def masks():
    return random_masks(2, SIZE, 0.5, np.random.default_rng(0))


def test_the_rasteriser_comes_nearer_to_the_rays_the_finer_it_samples(scene):
    pose = scene.world_to_camera[None]
    truth = ExactRenderer(8).views(scene, pose)[0]
    off = [np.median(np.abs(Renderer(samples).views(scene, pose)[0] - truth)) for samples in (1, 4, 16)]
    assert off[0] > 3 * off[1] > 9 * off[2]


def test_depth_along_the_rays_is_that_of_the_surfaces(scene):
    depth = ExactRenderer().depth(scene, scene.world_to_camera)
    assert np.nanmedian(np.abs(depth / scene.depth - 1)) < 0.01
    behind = np.diag([-1.0, 1.0, -1.0, 1.0])
    assert np.isnan(ExactRenderer().depth(scene, behind)).all()


def test_harmonics_are_seen_from_each_camera(scene):
    harmonics = torch.zeros(len(scene.gaussians), 3, 3)
    harmonics[:, 2] = 0.2
    shiny = replace(scene, gaussians=replace(scene.gaussians, harmonics=harmonics))
    pose = np.eye(4)[None]
    assert np.abs(ExactRenderer(1).views(shiny, pose)[0] - ExactRenderer(1).views(scene, pose)[0]).max() > 0.01


def test_exposures_take_either_renderer(scene, masks):
    effects = (MotionBlur(2), Defocus(0.02, 3.0))
    shots = [
        expose(scene, STILL, masks, RIG, effects=effects, seed=0, renderer=r) for r in (Renderer(4), ExactRenderer())
    ]
    rms = np.sqrt(np.square(shots[0].measurement - shots[1].measurement).mean())
    assert 1e-4 < rms < 0.05


def test_a_plan_draws_by_rays_where_the_rasteriser_is_off_by_more_than_its_share(scene, masks):
    look = preview(scene, STILL, masks, RIG)
    missed = rendering_error(look, ExactRenderer()).rms_dn
    assert missed > 1.0
    task = SimulationTask(scene, STILL, masks, RIG, (MotionBlur(),))
    fine = plan(task, exact=ExactRenderer())
    coarse = plan(task, PlanChoice(5 * missed), exact=ExactRenderer())
    assert isinstance(fine.renderer, ExactRenderer)
    assert "drawn by rays" in fine.summary()
    assert not isinstance(coarse.renderer, ExactRenderer)
    assert missed <= coarse.error_dn <= 5 * missed
    assert not isinstance(plan(task).renderer, ExactRenderer)


def test_the_error_of_the_rasteriser_that_a_plan_counts_is_no_less_than_the_true_one():
    large = planes(np.random.default_rng(3), (52, 60))  # more than one window
    open_masks = np.ones((2, 52, 60), np.float32)
    missed = rendering_error(preview(large, STILL, open_masks, RIG), ExactRenderer()).rms_dn
    chain = EffectChain((), 0, RIG)
    photons = [integrate(large, STILL, open_masks, chain, renderer=r) for r in (Renderer(), ExactRenderer())]
    true = RIG.sensor.quantum_efficiency * RIG.dn_per_e * np.sqrt(np.square(photons[0] - photons[1]).mean())
    assert 0.2 * missed <= true <= missed


def test_a_plan_of_rays_stays_within_its_tolerance_of_everything_drawn_by_rays(scene, masks):
    path = stage_move_for_parallax(scene, 0.5, RIG.exposure_s, wobble_deg=0.0)
    rays = ExactRenderer(2)
    decided = plan(SimulationTask(scene, path, masks, RIG, (MotionBlur(),)), PlanChoice(2.0), exact=rays)
    everything = simulate_everything(scene, path, masks, RIG, (MotionBlur(),), seed=0, settle_dn=0.2, renderer=rays)
    photons = integrate(scene, path, masks, EffectChain(decided.effects, 0, RIG), renderer=decided.renderer)
    assert deviation_dn(everything, photons, decided.effects, 0) <= decided.error_dn + 0.2
