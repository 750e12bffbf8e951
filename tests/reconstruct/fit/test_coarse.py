import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from gs2ci.core.errors import InputError, NumericsError, ResourceError
from gs2ci.core.findings import Code, finding
from gs2ci.core.progress import Silent
from gs2ci.reconstruct.choices import RULE_NAMES
from gs2ci.reconstruct.fit import coarse_state
from gs2ci.reconstruct.fit.coarse import MAX_ROLLBACKS, fit_coarse
from gs2ci.reconstruct.fit.coarse_settings import CoarseSettings
from gs2ci.reconstruct.fit.coarse_state import FitState
from gs2ci.reconstruct.fit.density.classic import Classic
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.depth_field import DepthFieldSettings
from gs2ci.reconstruct.fit.looks import Monitoring
from gs2ci.reconstruct.fit.losses import LossWeights
from gs2ci.reconstruct.fit.optimiser import GaussianOptimiser
from gs2ci.reconstruct.fit.pace import Fixed
from gs2ci.reconstruct.fit.poses import PoseSettings
from gs2ci.reconstruct.fit.rendering import ShotRenderer
from gs2ci.reconstruct.fit.rules import with_rule
from gs2ci.reconstruct.fit.start import first_gaussians
from gs2ci.reconstruct.fit.stopping import HoldOut, Rival
from gs2ci.reconstruct.fit.surfaces import Search, SurfaceSettings, find_surfaces
from gs2ci.reconstruct.geometry.points import seed_points
from gs2ci.reconstruct.measurement.holdout import Holdout, choose_heldout
from gs2ci.reconstruct.presets.paper import paper_settings
from gs2ci.render.cpu.backend import CpuBackend
from gs2ci.render.settings import RasterSettings

pytestmark = pytest.mark.slow

# Surfaces have tests of their own: those of the loop count its renderings.
FIELD = DepthFieldSettings()
QUICK = CoarseSettings(iterations=60, densify_every=20, surfaces=None, hold_out=HoldOut(share=0.05, look_every=10))
UNJUDGED = HoldOut(share=0.0, look_every=10, patience=10**6, growth_patience=10**6)


def run(
    moving_plane,
    settings=QUICK,
    *,
    backend=None,
    seed=0,
    listener=None,
    score=None,
    shot=None,
    pace=None,
    refine=lambda views: views,
    rival=None,
):
    given, geometry = moving_plane
    shot = shot or given
    holdout = Holdout.of(shot, settings.hold_out.share, seed)
    grey = np.full((*shot.masks.shape, shot.channels), 0.5, np.float32)
    fit = fit_coarse(
        holdout=holdout,
        renderer=ShotRenderer(shot, geometry.intrinsics, backend or CpuBackend()),
        start=first_gaussians(seed_points(geometry, grey, 2)),
        geometry=geometry,
        settings=settings,
        seed=seed,
        monitoring=Monitoring(refine, listener or Silent(), score),
        pace=pace,
        rival=rival,
    )
    return fit, holdout


class FaultyBackend(CpuBackend):
    """Gives gradients that are NaN in the renderings that `when` tells by their number."""

    def __init__(self, when):
        super().__init__()
        self._when = when
        self._calls = itertools.count()

    def coded_with_pull(self, *arguments):
        image, pull = super().coded_with_pull(*arguments)
        faulty = self._when(next(self._calls))
        return image, lambda gradient: pull(gradient * np.float32("nan") if faulty else gradient)


class Watching(CpuBackend):
    """Keeps lists, and remembers which population was rendered with which of them."""

    def __init__(self, every, when_faulty=lambda call: False):
        super().__init__(RasterSettings(relist_every=every))
        self.given = []
        self.populations = {}
        self._when_faulty = when_faulty
        self._calls = itertools.count()

    def coded_with_pull(self, scene, world_to_camera, intrinsics, coding, screen, reuse):
        if reuse not in self.given:
            self.given.append(reuse)
        self.populations.setdefault(reuse, set()).add(scene.means.data_ptr())
        image, pull = super().coded_with_pull(scene, world_to_camera, intrinsics, coding, screen, reuse)
        faulty = self._when_faulty(next(self._calls))
        return image, lambda gradient: pull(gradient * np.float32("nan") if faulty else gradient)


class Listener(Silent):
    def __init__(self):
        super().__init__()
        self.steps = []

    def step(self, done, **figures):
        self.steps.append((done, figures))


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


def test_a_fit_far_behind_its_rival_is_given_up_and_one_that_keeps_up_is_not(moving_plane):
    kept_up, _ = run(moving_plane, rival=Rival({20: 1e3}, QUICK.iterations))
    assert kept_up.curve[-1].iteration == QUICK.iterations
    given_up, _ = run(moving_plane, rival=Rival({20: 1e-9, 30: 1e-9}, QUICK.iterations))
    assert [point.iteration for point in given_up.curve] == [10, 20]
    assert given_up.stopped == finding(Code.FIT_BEHIND, iterations=20, best=20)


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
    assert turns[0][1] == max(start, int(0.25 * 32 * 40))
    assert fit.curve[-1].gaussians <= turns[0][1]


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
    assert first.curve[-1].gaussians <= max(first.curve[0].gaussians, int(0.25 * 32 * 40))
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
def test_the_papers_schedule_two_hundred_times_faster_stays_finite(moving_plane, name, seed):
    """All its turns, resets and bounds, on so few iterations; `tests/benchmarks/long_fits.py` runs all 20,000."""
    settings = with_rule(paper_settings().fit, name)
    rule = settings.density
    if hasattr(rule, "criteria"):
        every = rule.criteria.reset_every
        hurried = replace(rule.criteria, screen_until=20, reset_every=None if every is None else 15)
        settings = replace(settings, density=replace(rule, criteria=hurried))
    settings = replace(settings, iterations=100, densify_every=1, gaussians_per_pixel=0.6)
    fit, _ = run(moving_plane, settings, seed=seed)
    assert fit.stopped == finding(Code.FIT_ALL_DONE_UNJUDGED, iterations=100)
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


def test_surfaces_have_a_say_once_they_are_sought_and_the_measurement_has_the_last_word(moving_plane):
    plain, _ = run(moving_plane)
    drawn, _ = run(
        moving_plane, replace(QUICK, surfaces=SurfaceSettings((Search(0.5, 1e-2, 2e-4), Search(0.8, 1e-2, 2e-4))))
    )
    # Up to iteration 30 both are the same.
    assert [point.loss for point in drawn.curve[:3]] == [point.loss for point in plain.curve[:3]]
    assert drawn.curve[3].loss != plain.curve[3].loss
    assert drawn.curve[-1].heldout < 1.2 * plain.curve[-1].heldout


def test_regions_move_together_from_the_first_search_on(moving_plane):
    surfaces = SurfaceSettings((Search(0.5, 1e-2, 2e-4),))
    fits = [run(moving_plane, replace(QUICK, surfaces=replace(surfaces, depth_field=one)))[0] for one in (None, FIELD)]
    losses = [[point.loss for point in fit.curve] for fit in fits]
    assert losses[0][:3] == losses[1][:3]
    assert losses[0][3] != losses[1][3]
    assert fits[1].curve[-1].heldout < 1.2 * fits[0].curve[-1].heldout


def test_what_is_handed_over_has_been_through_the_surfaces_though_views_get_worse(moving_plane, monkeypatch):
    def wrong(*arguments):
        found = find_surfaces(*arguments)
        return replace(found, inverse_depth=3 * found.inverse_depth)

    monkeypatch.setattr(coarse_state, "find_surfaces", wrong)
    settings = SurfaceSettings((Search(0.5, 3.0, 3.0),), every=1)
    fit, holdout = run(moving_plane, replace(QUICK, surfaces=settings))
    before = [point.heldout for point in fit.curve if point.iteration <= 30]
    after = {point.iteration: point.heldout for point in fit.curve if point.iteration > 30}
    assert min(before) < min(after.values())
    assert holdout.residual_rms(fit.views) == pytest.approx(min(after.values()), rel=1e-6)
    assert fit.stopped.figures["best"] in after


def test_turning_is_exchanged_for_travel_unless_the_path_was_told_or_the_scene_moves(moving_plane):
    shot, geometry = moving_plane
    without = replace(QUICK, relief=None)
    free, _ = run(moving_plane)
    kept, _ = run(moving_plane, without)
    # The first tenth of the schedule is the same, up to iteration 6: the first look is past it.
    assert not np.array_equal(free.world_to_camera, kept.world_to_camera)
    for given in (replace(geometry, source="stage"), replace(geometry, source="file")):
        told, _ = run((shot, given))
        assert np.array_equal(told.world_to_camera, kept.world_to_camera)
        assert np.array_equal(told.views, kept.views)
    fixed = PoseSettings(refine=False)
    one, two = (run(moving_plane, replace(settings, poses=fixed))[0] for settings in (QUICK, without))
    assert np.array_equal(one.views, two.views)


def test_poses_that_step_seldom_cannot_exchange_turning_for_travel():
    seldom = replace(QUICK, poses=PoseSettings(every=5))
    with pytest.raises(InputError, match="every 5 iterations"):
        seldom.check()
    replace(seldom, relief=None).check()


def test_surfaces_are_sought_in_the_views_that_would_be_handed_over(moving_plane, monkeypatch):
    swept = []

    def watched(renderer, scene, poses, views, settings, seed, search, readings):
        swept.append((search, views.copy()))
        return find_surfaces(renderer, scene, poses, views, settings, seed, search, readings)

    monkeypatch.setattr(coarse_state, "find_surfaces", watched)
    searches = (Search(0.3, 1e-2, 2e-4), Search(0.6, 3e-2, 1e-3))
    run(moving_plane, replace(QUICK, surfaces=SurfaceSettings(searches)), refine=lambda views: 0 * views + 0.25)
    assert [search for search, _ in swept] == list(searches)
    assert all((views == 0.25).all() for _, views in swept)


def test_a_search_that_finds_nothing_leaves_what_was_found_before(moving_plane, monkeypatch):
    given = SurfaceSettings((Search(0.3, 1e-2, 1e-2), Search(0.6, 3e-2, 1e-3)))
    once = replace(given, searches=given.searches[:1])
    found, _ = run(moving_plane, replace(QUICK, surfaces=once))

    def first_only(*arguments):
        return find_surfaces(*arguments) if arguments[6] == given.searches[0] else None

    monkeypatch.setattr(coarse_state, "find_surfaces", first_only)
    kept, _ = run(moving_plane, replace(QUICK, surfaces=given))
    assert np.array_equal(kept.views, found.views)


def test_only_searches_that_ask_the_measurement_are_given_it_without_what_is_held_out(moving_plane, monkeypatch):
    shot, _ = moving_plane
    given = []

    def watched(*arguments):
        given.append(arguments[7])
        return find_surfaces(*arguments)

    monkeypatch.setattr(coarse_state, "find_surfaces", watched)
    searches = (Search(0.3, 1e-2, 2e-4), Search(0.6, 3e-2, 1e-3, asks_measurement=True))
    _, holdout = run(moving_plane, replace(QUICK, surfaces=SurfaceSettings(searches)))
    assert given[0] is None
    assert not (given[1].usable & holdout.pixels).any()
    assert given[1].usable.sum() > 0.9 * shot.lit.sum()
    assert np.array_equal(given[1].open_share, shot.masks * shot.weights[:, None, None])


def test_without_parallax_no_surface_is_sought(moving_plane):
    shot, geometry = moving_plane
    still = replace(geometry, verdict="rotation_only")
    settings = replace(QUICK, surfaces=SurfaceSettings())
    plain, _ = run((shot, still), QUICK)
    fit, _ = run((shot, still), settings)
    assert np.array_equal(fit.views, plain.views)


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


def test_every_population_has_lists_of_its_own(moving_plane):
    backend = Watching(8)
    fit, _ = run(moving_plane, backend=backend)
    # The density rule has its turn at iterations 20 and 40.
    assert len(backend.given) == 3
    assert all(len(tensors) == 1 for tensors in backend.populations.values())
    assert [reuse.listings for reuse in backend.given] == [3, 3, 3]
    assert fit.curve[-1].iteration == 60


def test_a_roll_back_makes_lists_anew(moving_plane):
    backend = Watching(1000, when_faulty=lambda call: call == 10)
    fit, _ = run(moving_plane, replace(QUICK, densify_every=1000), backend=backend)
    assert len(fit.notes) == 1
    assert [reuse.listings for reuse in backend.given] == [1, 1]


def test_kept_lists_lead_to_as_low_a_loss(moving_plane, threads):
    fresh, _ = run(moving_plane)
    results = []
    for count in (1, 2):
        with threads(count):
            results.append(run(moving_plane, backend=CpuBackend(RasterSettings(relist_every=4)))[0])
    assert results[0].curve[-1].loss == pytest.approx(fresh.curve[-1].loss, rel=0.05)
    np.testing.assert_array_equal(results[0].views, results[1].views)


def test_one_bad_iteration_is_rolled_back_and_told(moving_plane):
    listener = Listener()
    fit, _ = run(moving_plane, backend=FaultyBackend(lambda call: call == 25), listener=listener)
    assert fit.notes == (finding(Code.ROLLED_BACK_NOT_FINITE, iteration=25, best=20),)
    assert listener.sentences == [note.sentence for note in fit.notes]
    assert fit.curve[-1].iteration == 60
    assert fit.curve[-1].loss < 0.6 * fit.curve[0].loss
    assert np.isfinite(fit.views).all()


@pytest.mark.parametrize(("name", "factor"), [("colours", 1e3), ("means", 1e5)])
def test_a_step_that_explodes_is_rolled_back_and_told(moving_plane, monkeypatch, name, factor):
    whole, calls = GaussianOptimiser.step, itertools.count()

    def step(optimiser, *arguments):
        whole(optimiser, *arguments)
        if next(calls) == 25:
            with torch.no_grad():
                optimiser.scene.parameters()[name].mul_(factor)

    monkeypatch.setattr(GaussianOptimiser, "step", step)
    fit, _ = run(moving_plane)
    (note,) = fit.notes
    assert note.code is Code.ROLLED_BACK_EXPLODED
    assert (note.figures["iteration"], note.figures["best"]) == (26, 20)
    assert fit.curve[-1].loss < 0.6 * fit.curve[0].loss
    fit.scene.check()


def continued(moving_plane, warm_up, backend=None):
    """Continue a fit of the plane from its scene and its path, for twelve iterations."""
    shot, geometry = moving_plane
    done, holdout = run(moving_plane)
    settings = replace(
        QUICK, iterations=12, densify_until=0.0, warm_up=warm_up, hold_out=HoldOut(share=0.05, look_every=1)
    )
    return fit_coarse(
        holdout=holdout,
        renderer=ShotRenderer(shot, geometry.intrinsics, backend or CpuBackend()),
        start=done.scene,
        geometry=replace(geometry, world_to_camera=done.world_to_camera),
        settings=settings,
        seed=0,
        monitoring=Monitoring(lambda views: views, Silent()),
    )


def test_a_fitted_scene_bears_to_be_fitted_on_if_the_steps_grow_slowly(moving_plane):
    cold, warm = ([point.loss for point in continued(moving_plane, steps).curve] for steps in (0, 10))
    assert warm[0] == cold[0]
    assert max(warm) < 1.1 * cold[0] < max(cold)


def test_steps_grow_anew_after_a_roll_back(moving_plane, monkeypatch):
    whole, dampings = FitState.step, []

    def step(state, share, damping):
        dampings.append(damping)
        whole(state, share, damping)

    monkeypatch.setattr(FitState, "step", step)
    continued(moving_plane, 4, FaultyBackend(lambda call: call == 6))
    dampings = dampings[-12:]
    assert dampings == pytest.approx([0.25, 0.5, 0.75, 1, 1, 1, 0.125, 0.25, 0.375, 0.5, 0.5, 0.5])


def test_numbers_that_keep_running_away_end_the_fit_with_a_sentence_and_the_last_good_state(moving_plane):
    fit, holdout = run(moving_plane, backend=FaultyBackend(lambda call: call >= 25))
    assert fit.stopped == finding(Code.FIT_DIVERGED, times=MAX_ROLLBACKS, best=20)
    assert len(fit.notes) == MAX_ROLLBACKS
    assert holdout.residual_rms(fit.views) == pytest.approx(fit.curve[-1].heldout, rel=1e-6)
    fit.scene.check()


def test_a_first_iteration_that_is_not_finite_is_an_error(moving_plane):
    with pytest.raises(NumericsError, match="first iteration"):
        run(moving_plane, backend=FaultyBackend(lambda call: call == 0))


@pytest.mark.parametrize(
    "settings",
    [{"iterations": 0}, {"densify_every": 0}, {"hold_out": HoldOut(share=2.0)}, {"loss": LossWeights(window_px=4)}],
)
def test_settings_that_make_no_sense_are_refused(moving_plane, settings):
    with pytest.raises(InputError):
        replace(CoarseSettings(), **settings).check()
    shot, geometry = moving_plane
    with pytest.raises(InputError):
        fit_coarse(
            holdout=Holdout(shot, np.zeros(shot.size, bool)),
            renderer=ShotRenderer(shot, geometry.intrinsics, CpuBackend()),
            start=first_gaussians(seed_points(geometry, np.zeros((4, 32, 40, 3), np.float32), 2)),
            geometry=geometry,
            settings=replace(CoarseSettings(), **settings),
            seed=0,
            monitoring=Monitoring(lambda views: views),
        )


def test_whoever_waits_hears_when_the_pace_changes_the_number_of_iterations(moving_plane):
    class Stretched(Fixed):
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
