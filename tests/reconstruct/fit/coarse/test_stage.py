"""The fit of a plane: its loop, its density rule, its looks and its end."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError, ResourceError
from gs2ci.core.findings import Code, finding
from gs2ci.core.progress import Silent
from gs2ci.reconstruct.choices import RULE_NAMES
from gs2ci.reconstruct.fit.coarse.exposure import FittedExposure
from gs2ci.reconstruct.fit.coarse.looks import Monitoring
from gs2ci.reconstruct.fit.coarse.pace import Pace
from gs2ci.reconstruct.fit.coarse.settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse.stopping import HoldOut, Watch
from gs2ci.reconstruct.fit.density.classic import Classic
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.losses.objective import LossWeights
from gs2ci.reconstruct.fit.optimiser.poses import PoseSettings
from gs2ci.reconstruct.fit.rules import with_rule
from gs2ci.reconstruct.fit.scene.rendering import ShotRenderer
from gs2ci.reconstruct.fit.scene.start import first_gaussians
from gs2ci.reconstruct.fit.surfaces.surfaces import Search, SurfaceSettings
from gs2ci.reconstruct.geometry.points import seed_points
from gs2ci.reconstruct.measurement.holdout import Holdout, choose_heldout
from gs2ci.reconstruct.paper.preset import paper_settings
from gs2ci.render.cpu.backend import CpuBackend
from gs2ci.render.settings import RasterSettings
from tests.reconstruct.fit.plane_fits import QUICK, UNJUDGED, Listener, Watching, fit_coarse, paused, run

pytestmark = pytest.mark.slow


def test_the_loss_and_the_held_out_residual_fall(moving_plane):
    fit, _ = run(moving_plane)
    assert [point.iteration for point in fit.curve] == [10, 20, 30, 40, 50, 60]
    assert fit.curve[-1].loss < 0.7 * fit.curve[0].loss
    assert fit.curve[-1].heldout < 0.7 * fit.curve[0].heldout
    assert fit.notes == ()
    assert np.isfinite(fit.views).all()
    assert fit.views.shape == (4, 32, 40, 3)
    assert all(a.seconds <= b.seconds for a, b in itertools.pairwise(fit.curve))


def test_the_views_returned_are_those_of_the_best_look(moving_plane):
    fit, holdout = run(moving_plane, replace(QUICK, iterations=200, hold_out=replace(QUICK.hold_out, patience=20)))
    best = min(point.heldout for point in fit.curve)
    assert holdout.residual_rms(fit.views) == pytest.approx(best, rel=1e-6)
    at = next(point.iteration for point in fit.curve if point.heldout == best)
    if fit.stopped.code is Code.FIT_STALLED:
        assert fit.curve[-1].iteration < 200
    assert fit.stopped.figures["best"] == at


def test_a_fit_that_stops_improving_ends_early_and_says_so(moving_plane):
    settings = replace(QUICK, hold_out=replace(QUICK.hold_out, patience=20, improvement=0.9))
    fit, _ = run(moving_plane, settings)
    assert fit.curve[-1].iteration < settings.iterations
    assert fit.stopped.code is Code.FIT_STALLED


def test_a_fit_that_only_gets_worse_ends_though_surfaces_are_still_to_come(moving_plane, monkeypatch):
    monkeypatch.setattr(Watch, "has_risen", lambda _, iteration: iteration >= 30)
    settings = replace(QUICK, surfaces=SurfaceSettings(searches=(Search(0.9, 1e-3, 1e-3),)))
    fit, _ = run(moving_plane, settings)
    assert fit.curve[-1].iteration == 30
    assert fit.stopped.code is Code.FIT_STALLED


def test_a_fit_that_was_paused_goes_on_as_if_it_had_not_been(moving_plane):
    whole, _ = run(moving_plane)
    fit, _ = paused(moving_plane)
    for share, done in ((0.25, 15), (0.25, 15), (0.5, 30), (1.0, 60)):
        fit.advance(share)
        assert (fit.iterations, fit.has_ended) == (done, share == 1.0)
    assert [(point.iteration, point.loss) for point in fit.curve] == [(one.iteration, one.loss) for one in whole.curve]
    assert np.array_equal(fit.result().views, whole.views)


def test_a_fit_that_goes_on_reports_its_steps_under_its_own_name(moving_plane):
    class Stages(Silent):
        name, steps = "", ()

        def stage(self, name, total=None):
            self.name = (name, total)

        def step(self, done, **figures):
            self.steps = (*self.steps, (*self.name, done))

    listener = Stages()
    fit, _ = paused(moving_plane, listener=listener)
    fit.advance(0.5)
    listener.stage("geometry", 3)
    fit.advance()
    assert {step[:2] for step in listener.steps} == {("fit", 60)}
    assert listener.steps[-1] == ("fit", 60, 60)


def test_a_fit_that_is_not_continued_is_given_up_with_its_best_state(moving_plane):
    fit, _ = paused(moving_plane)
    fit.advance(0.4)
    found = fit.result()
    assert found.stopped == finding(Code.FIT_BEHIND, iterations=24, best=20)
    fit.advance()
    assert fit.iterations == 24
    assert fit.result() is found


def test_without_held_out_pixels_all_iterations_run_and_the_sentence_says_that_nothing_judged(moving_plane):
    fit, _ = run(moving_plane, replace(QUICK, hold_out=replace(QUICK.hold_out, share=0.0, patience=10)))
    assert fit.stopped == finding(Code.FIT_ALL_DONE_UNJUDGED, iterations=60)
    assert all(point.heldout is None for point in fit.curve)


def test_what_was_measured_on_held_out_pixels_changes_no_step_of_the_fit(moving_plane):
    shot, _ = moving_plane
    patient = replace(QUICK, hold_out=replace(QUICK.hold_out, patience=10**6, growth_patience=10**6))
    heldout = choose_heldout(shot, 0.05, seed=0)
    measurement = shot.measurement.copy()
    measurement[heldout] *= 0.9
    first, _ = run(moving_plane, patient)
    second, _ = run(moving_plane, patient, shot=replace(shot, measurement=measurement))
    assert [p.heldout for p in first.curve] != [p.heldout for p in second.curve]
    assert [(p.loss, p.gaussians) for p in first.curve] == [(p.loss, p.gaussians) for p in second.curve]


def test_the_density_rule_gets_its_turns_between_the_shares_of_the_schedule(moving_plane):
    turns = []

    class Witness:
        name = "witness"

        def shake(self, scene, rate, generator):
            return None

        def change(self, scene, evidence, generator):
            turns.append((len(scene), evidence.cap, tuple(evidence.screen_gradient.shape)))
            assert torch.isfinite(evidence.screen_gradient).all()
            assert (evidence.screen_gradient > 0).any()
            return CoarseSettings().density.change(scene, evidence, generator)

    fit, _ = run(moving_plane, replace(QUICK, densify_every=10, densify_until=0.5, density=Witness()))
    assert len(turns) == 2  # at iterations 10 and 20; 30 is half the schedule
    start = turns[0][0]
    assert [gradient for _, _, gradient in turns] == [(count,) for count, _, _ in turns]
    assert turns[0][1] == max(start, int(QUICK.gaussians_per_pixel * 32 * 40))
    assert fit.curve[-1].gaussians <= turns[0][1]


@pytest.mark.parametrize("weight", [0.0625, 8.0])
def test_masks_shown_for_shorter_or_longer_give_the_same_scene(moving_plane, weight):
    """By powers of two, so that every product is exact: opacities and sizes weigh no more in the dark."""
    shot, _ = moving_plane
    shown = replace(shot, measurement=shot.measurement * weight, weights=shot.weights * weight)
    settings = replace(QUICK, iterations=40, densify_every=10, loss=LossWeights(size=0.01))
    plain, _ = run(moving_plane, settings)
    fit, _ = run(moving_plane, settings, shot=shown)
    for name, parameter in plain.scene.parameters().items():
        torch.testing.assert_close(fit.scene.parameters()[name], parameter, rtol=0, atol=0)
    np.testing.assert_array_equal(fit.views, plain.views)
    assert [point.loss for point in fit.curve] == [point.loss for point in plain.curve]
    assert [point.heldout for point in fit.curve] == [weight * point.heldout for point in plain.curve]


@pytest.mark.parametrize("name", RULE_NAMES)
def test_every_rule_lowers_the_loss_and_keeps_to_the_cap_and_the_thread_count_changes_no_bit(
    moving_plane, threads, name
):
    settings = with_rule(replace(QUICK, iterations=40, densify_every=10), name)
    fits = []
    for count in (1, 2):
        with threads(count):
            fits.append(run(moving_plane, settings)[0])
    first, other = fits
    assert first.curve[-1].loss < 0.8 * first.curve[0].loss
    assert first.curve[-1].gaussians <= max(first.curve[0].gaussians, int(QUICK.gaussians_per_pixel * 32 * 40))
    assert first.notes == ()
    first.scene.check()
    for key, tensor in first.scene.parameters().items():
        assert torch.equal(tensor, other.scene.parameters()[key]), key


def test_the_rule_shakes_after_every_step_with_the_present_rate(moving_plane):
    rates = []

    class Shaker(Osgr):
        def shake(self, scene, rate, generator):
            rates.append(rate)
            return torch.full_like(scene.means, 1e-3)

    shaken, _ = run(moving_plane, replace(QUICK, iterations=3, density=Shaker()))
    still, _ = run(moving_plane, replace(QUICK, iterations=3))
    assert len(rates) == 3
    assert rates[0] > rates[1] > rates[2] > 0
    assert not torch.equal(shaken.scene.means, still.scene.means)


def test_from_its_share_of_the_schedule_on_the_population_is_bounded_by_what_it_is_then(moving_plane):
    """Supplement II; opacity splits of a tenth would grow it at every turn."""
    rule = Osgr(extra_splits=0.1)
    growing = replace(
        QUICK, densify_every=10, densify_until=1.0, gaussians_per_pixel=2.0, density=rule, hold_out=UNJUDGED
    )
    free, _ = run(moving_plane, growing)
    bounded, _ = run(moving_plane, replace(growing, cap_from=0.5))
    counts = {point.iteration: point.gaussians for point in bounded.curve}
    assert counts[30] == counts[60]
    assert [p.gaussians for p in free.curve[:3]] == [p.gaussians for p in bounded.curve[:3]]
    assert free.curve[-1].gaussians > bounded.curve[-1].gaussians > counts[10]


def test_a_reset_of_opacities_is_no_run_away_and_the_fit_recovers_from_it(moving_plane):
    settings = replace(
        QUICK,
        iterations=300,
        densify_until=0.37,
        density=Osgr(criteria=Classic(reset_every=100)),
        hold_out=replace(UNJUDGED, look_every=1),
    )
    fit, _ = run(moving_plane, settings)
    loss = {point.iteration: point.loss for point in fit.curve}
    assert loss[102] > 2 * loss[100]
    assert loss[300] < 1.5 * loss[100]
    assert fit.notes == ()


def test_a_reset_of_opacities_does_not_end_a_fit_for_want_of_improvement(moving_plane):
    rule = Osgr(criteria=Classic(reset_every=100))
    settings = replace(QUICK, iterations=140, densify_until=0.9, density=rule)
    fit, _ = run(moving_plane, replace(settings, hold_out=replace(QUICK.hold_out, patience=20, growth_patience=100)))
    heldout = {point.iteration: point.heldout for point in fit.curve}
    assert heldout[110] > 1.2 * heldout[100]
    assert fit.curve[-1].iteration > 120


@pytest.mark.parametrize("name", RULE_NAMES)
@pytest.mark.parametrize("seed", range(3))
def test_the_papers_schedule_four_hundred_times_faster_stays_finite(moving_plane, name, seed):
    """All its turns, resets and bounds, on so few iterations; `tests/benchmarks/long_fits.py` runs all 20,000."""
    settings = with_rule(paper_settings().fit, name)
    rule = settings.density
    if hasattr(rule, "criteria"):
        every = rule.criteria.reset_every
        hurried = replace(rule.criteria, screen_until=15, reset_every=None if every is None else 12)
        settings = replace(settings, density=replace(rule, criteria=hurried))
    settings = replace(settings, iterations=50, densify_every=1, gaussians_per_pixel=0.6)
    fit, _ = run(moving_plane, settings, seed=seed)
    assert fit.stopped == finding(Code.FIT_ALL_DONE_UNJUDGED, iterations=50)
    assert fit.notes == ()
    assert np.isfinite(fit.views).all()
    fit.scene.check()


def test_a_population_beyond_the_memory_guard_ends_the_fit_with_an_error(moving_plane):
    settings = replace(QUICK, gaussians_per_pixel=None, most_gaussians=330, densify_until=1.0)
    greedy = Osgr(criteria=Classic(gradient=0.0), opacity_splits=False)
    with pytest.raises(ResourceError, match=r"wants [\d,]+ Gaussians at iteration \d+; allowed: at most 330"):
        run(moving_plane, replace(settings, density=greedy))


def test_poses_move_only_when_they_are_refined(moving_plane):
    _, geometry = moving_plane
    held, _ = run(moving_plane, replace(QUICK, poses=PoseSettings(refine=False)))
    np.testing.assert_array_equal(held.world_to_camera, geometry.world_to_camera.astype(np.float32))
    moved, _ = run(moving_plane)
    assert (moved.world_to_camera != held.world_to_camera).any()
    np.testing.assert_allclose(np.linalg.det(moved.world_to_camera[:, :3, :3]), 1, atol=1e-5)


def test_the_same_seed_gives_the_same_bits_twice_and_on_any_number_of_threads(moving_plane, threads):
    fits = []
    for count in (1, 2, 2):
        with threads(count):
            fits.append(run(moving_plane, replace(QUICK, iterations=30, densify_every=10))[0])
    for other in fits[1:]:
        np.testing.assert_array_equal(other.views, fits[0].views)
        np.testing.assert_array_equal(other.world_to_camera, fits[0].world_to_camera)
        assert torch.equal(other.scene.means, fits[0].scene.means)
        assert [p.loss for p in other.curve] == [p.loss for p in fits[0].curve]


def test_a_mono_measurement_gives_mono_views(moving_plane):
    shot, _ = moving_plane
    mono = replace(shot, measurement=shot.measurement.mean(axis=2, keepdims=True)).check()
    fit, _ = run(moving_plane, shot=mono)
    assert fit.views.shape == (4, 32, 40, 1)
    assert fit.curve[-1].loss < 0.7 * fit.curve[0].loss


def test_a_mosaic_gives_colour_views(moving_plane):
    shot, _ = moving_plane
    mosaic = replace(shot, measurement=shot.measurement[..., :1].copy(), cfa="GRBG").check()
    fit, _ = run(moving_plane, shot=mosaic)
    assert fit.views.shape == (4, 32, 40, 3)
    assert fit.curve[-1].loss < 0.7 * fit.curve[0].loss


def test_the_score_of_the_refined_views_is_reported_at_each_look(moving_plane):
    listener = Listener()
    fit, _ = run(moving_plane, score=lambda views: float(views.mean()), listener=listener)
    assert all(point.psnr_db is not None for point in fit.curve)
    assert [done for done, _ in listener.steps] == list(range(1, 61))
    assert {"loss", "gaussians"} <= set(listener.steps[0][1])
    assert listener.steps[-1][1]["psnr_db"] == fit.curve[-1].psnr_db
    assert listener.steps[-1][1]["heldout"] == fit.curve[-1].heldout


def test_a_look_at_the_coded_image_judges_the_views(moving_plane):
    fit, holdout = run(moving_plane)
    best = min(point.heldout for point in fit.curve)
    assert holdout.residual_rms(fit.views) == pytest.approx(best, rel=1e-3)


def test_every_population_has_lists_of_its_own(moving_plane):
    backend = Watching(8)
    fit, _ = run(moving_plane, backend=backend)
    # The density rule has its turn at iterations 20 and 40.
    assert len(backend.given) == 3
    assert all(len(tensors) == 1 for tensors in backend.populations.values())
    assert [reuse.listings for reuse in backend.given] == [3, 3, 3]
    assert fit.curve[-1].iteration == 60


def test_kept_lists_lead_to_as_low_a_loss(moving_plane, threads):
    fresh, _ = run(moving_plane)
    results = []
    for count in (1, 2):
        with threads(count):
            results.append(run(moving_plane, backend=CpuBackend(RasterSettings(relist_every=4)))[0])
    assert results[0].curve[-1].loss == pytest.approx(fresh.curve[-1].loss, rel=0.05)
    np.testing.assert_array_equal(results[0].views, results[1].views)


@pytest.mark.parametrize(
    "settings",
    [{"iterations": 0}, {"densify_every": 0}, {"hold_out": HoldOut(share=2.0)}, {"loss": LossWeights(window_px=4)}],
)
def test_settings_that_make_no_sense_are_refused(moving_plane, settings):
    with pytest.raises(InputError):
        replace(CoarseSettings(), **settings).check()
    shot, geometry = moving_plane
    renderer = ShotRenderer(shot, geometry.intrinsics, CpuBackend())
    with pytest.raises(InputError):
        fit_coarse(
            FittedExposure(Holdout(shot, np.zeros(shot.size, bool)), renderer, geometry),
            start=first_gaussians(seed_points(geometry, np.zeros((4, 32, 40, 3), np.float32), 2)),
            settings=replace(CoarseSettings(), **settings),
            seed=0,
            monitoring=Monitoring(),
        )


def test_whoever_waits_hears_when_the_pace_changes_the_number_of_iterations(moving_plane):
    class Stretched(Pace):
        def total(self, done):
            return 4 if done < 2 else 6

    class Waiting(Silent):
        expected = ()

        def expect(self, total):
            self.expected += (total,)

    waiting = Waiting()
    fit, _ = run(moving_plane, QUICK, listener=waiting, pace=Stretched(4))
    assert waiting.expected == (6,)
    assert fit.curve[-1].iteration == 6
