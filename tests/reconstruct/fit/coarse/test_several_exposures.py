"""One scene fitted to several exposures of a plane, each coded by masks of its own."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.cameras import path_extent
from gs2ci.core.records import Shot
from gs2ci.reconstruct.fit.coarse.exposure import ExposureState, FittedExposure
from gs2ci.reconstruct.fit.coarse.looks import Monitoring
from gs2ci.reconstruct.fit.coarse.stage import CoarseRun
from gs2ci.reconstruct.fit.coarse.state import FitState
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.fit.scene.start import first_gaussians
from gs2ci.reconstruct.fit.surfaces.surfaces import Search, SurfaceSettings
from gs2ci.reconstruct.geometry.points import seed_points
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.render.cpu.backend import CpuBackend
from tests.reconstruct.fit.plane_fits import QUICK, run

pytestmark = pytest.mark.slow


def recoded(shot: Shot, views: np.ndarray, seed: int) -> Shot:
    """Return views coded by other masks, and read with noise of a tenth of their full scale."""
    draw = np.random.default_rng(seed)
    masks = (draw.random(shot.masks.shape) < 0.4).astype(np.float32)
    read = np.einsum("nhw,nhwc->hwc", masks, views)
    return replace(shot, masks=masks, measurement=read + 0.1 * draw.standard_normal(read.shape, np.float32))


@pytest.fixture(scope="module")
def exposures(moving_plane):
    """Return three exposures of the plane, and the views that they code."""
    shot, geometry = moving_plane
    fit, _ = run(moving_plane, replace(QUICK, iterations=120))
    views = np.clip(fit.views, 0, 1)
    shots = [recoded(shot, views, seed) for seed in (1, 2, 3)]
    return [
        FittedExposure(Holdout.of(one, 0.05, seed), ShotRenderer(one, geometry.intrinsics, CpuBackend()), geometry)
        for seed, one in enumerate(shots)
    ], views


def fitted(exposures, settings=QUICK, seed=0):
    geometry = exposures[0].geometry
    grey = np.full((*exposures[0].holdout.shot.masks.shape, 3), 0.5, np.float32)
    return CoarseRun(exposures, first_gaussians(seed_points(geometry, grey, 2)), settings, seed, Monitoring())


def test_a_round_works_on_each_exposure_once(exposures, monkeypatch):
    worked = []
    whole = ExposureState.backward

    def watched(state, *arguments):
        worked.append(state.exposure)
        return whole(state, *arguments)

    monkeypatch.setattr(ExposureState, "backward", watched)
    given, _ = exposures
    fitted(given, replace(QUICK, iterations=12)).advance()
    rounds = [worked[at : at + 3] for at in range(0, 12, 3)]
    assert all({id(one) for one in turn} == {id(one) for one in given} for turn in rounds)
    assert len({tuple(id(one) for one in turn) for turn in rounds}) > 1


def test_steps_of_depth_are_as_long_as_along_one_path_however_far_apart_exposures_lie(exposures):
    one, other, _ = exposures[0]
    path = other.geometry.world_to_camera.copy()
    path[:, 0, 3] += 10 * path_extent(path)
    far = replace(other, geometry=replace(other.geometry, world_to_camera=path))
    start = first_gaussians(seed_points(one.geometry, np.full((*one.holdout.shot.masks.shape, 3), 0.5, np.float32), 2))
    moved = []
    for given in ((one,), (one, far)):
        fit = FitState(given, start, QUICK, 0)
        pose = one.geometry.world_to_camera[one.geometry.reference]
        ahead = torch.from_numpy(pose[2, :3]).float()
        fit.scene.means.grad = ahead.expand_as(fit.scene.means).clone()
        before = fit.scene.means.detach().clone()
        fit.optimiser.step(0.0)
        moved.append(((fit.scene.means.detach() - before) @ ahead).numpy())
        assert fit.extent == pytest.approx(path_extent(one.geometry.world_to_camera))
    assert np.abs(moved[0]).min() > 0
    np.testing.assert_allclose(moved[1], moved[0])


def test_one_scene_predicts_the_held_out_pixels_of_all(exposures):
    given, _ = exposures
    fit = fitted(given, replace(QUICK, iterations=120, hold_out=HoldOut(share=0.05, look_every=30)))
    fit.advance()
    results = [*map(fit.result, range(len(given)))]
    assert len(results) == len(given)
    assert all(one.scene is results[0].scene for one in results)
    left = [one.holdout.residual_rms(found.views) for one, found in zip(given, results, strict=True)]
    best = min(point.heldout for point in fit.curve)
    assert np.sqrt(np.mean(np.square(left))) == pytest.approx(best, rel=1e-5)
    assert best < fit.curve[0].heldout


def test_more_exposures_of_the_same_views_give_better_ones(exposures):
    given, views = exposures
    settings = replace(QUICK, iterations=120, hold_out=HoldOut(share=0.05, look_every=30))
    errors = []
    for count in (1, 3):
        fit = fitted(given[:count], settings)
        fit.advance()
        errors.append(float(np.mean((fit.result().views - views) ** 2)))
    assert errors[1] < 0.7 * errors[0]


def test_the_order_of_exposures_follows_from_the_seed(exposures):
    given, _ = exposures
    losses = []
    for seed in (0, 0, 1):
        fit = fitted(given, replace(QUICK, iterations=30), seed)
        fit.advance()
        losses.append([point.loss for point in fit.curve])
    assert losses[0] == losses[1] != losses[2]


def test_paths_that_are_tied_a_bit_wrong_come_to_lie_where_they_belong(exposures):
    given, _ = exposures
    off = given[1].geometry.world_to_camera.copy()
    off[:, 1, 3] += 0.02  # 0.8 px
    wrong = replace(given[1], geometry=replace(given[1].geometry, world_to_camera=off))
    fit = fitted([given[0], wrong, given[2]], replace(QUICK, iterations=300))
    fit.advance()
    first, second, _ = (one.world_to_camera[:, 1, 3] for one in map(fit.result, range(3)))
    assert abs(np.mean(second - first)) < 0.7 * 0.02


def test_each_exposure_has_surfaces_of_its_own_and_all_are_restored(exposures):
    given, _ = exposures
    surfaces = SurfaceSettings((Search(0.4, 1e-2, 2e-4), Search(0.6, 1e-2, 2e-4)), margin=None)
    fit = fitted(given, replace(QUICK, surfaces=surfaces))
    fit.advance()
    state: FitState = fit._fit
    assert all(one.surfaces is not None for one in state.exposures)
    assert len({id(one.surfaces) for one in state.exposures}) == 3
    before = state.snapshot(60)
    for one in state.exposures:
        one.surfaces = None
        one.poses.restore(one.poses.snapshot() + 1)
    state.restore(before)
    assert [one.surfaces for one in state.exposures] == list(before.surfaces)
    assert all(
        torch.equal(one.poses.snapshot(), twists) for one, twists in zip(state.exposures, before.twists, strict=True)
    )
