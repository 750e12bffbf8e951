"""When the fits of a reconstruction are asked for the order of depth, and that they do answer."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import NumericsError
from gs2ci.core.findings import Code, finding
from gs2ci.core.progress import Silent
from gs2ci.core.records import Shot
from gs2ci.reconstruct.attempts import fits, order
from gs2ci.reconstruct.attempts.attempt import Attempt, How
from gs2ci.reconstruct.first_look import FirstLook, from_rest
from gs2ci.reconstruct.fit.coarse_settings import CoarseSettings
from gs2ci.reconstruct.fit.density.osgr import Osgr
from gs2ci.reconstruct.fit.ensemble import members
from gs2ci.reconstruct.fit.refinement import Refinement
from gs2ci.reconstruct.fit.start import first_gaussians
from gs2ci.reconstruct.fit.stopping import HoldOut
from gs2ci.reconstruct.fit.withheld import Withheld
from gs2ci.reconstruct.geometry.initialise import Geometry
from gs2ci.reconstruct.geometry.points import seed_points
from gs2ci.reconstruct.geometry.view_depths import ViewDepth
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.settings import Settings
from gs2ci.reconstruct.stopwatch import Stopwatch

SIZE, VIEWS = (24, 32), 4
LONG = Settings(fit=CoarseSettings(iterations=250))


@pytest.fixture
def first():
    rng = np.random.default_rng(0)
    views = rng.random((VIEWS, *SIZE, 3)).astype(np.float32)
    masks = (rng.random((VIEWS, *SIZE)) < 0.4).astype(np.float32)
    intrinsics = np.array([[60.0, 0, 16], [0, 60, 12], [0, 0, 1]])
    coded = (masks[..., None] * views).sum(axis=0)
    shot = Shot(measurement=coded, masks=masks, weights=np.ones(VIEWS, np.float32), intrinsics=intrinsics).check()
    poses = np.tile(np.eye(4), (VIEWS, 1, 1))
    poses[:, 0, 3] = (-0.02, -0.01, 0, 0.01)
    depth = np.tile(np.linspace(1.3, 0.7, SIZE[1], dtype=np.float32), (SIZE[0], 1))
    geometry = Geometry(poses, intrinsics, "file", depth, 2, 100, 0.3, 2.0, "full", ())
    return FirstLook(Holdout.of(shot, 0.05, 0), views, geometry, None)


def settled(first, settings, *, hurried=False):
    refine = Refinement(first.holdout, settings.residual)
    asked = fits.Fits(first.holdout, first.holdout, None, settings, refine, Silent(), Stopwatch())
    return asked.settle_order(first, hurried=hurried)


def codes(look):
    return [note.code for note in look.geometry.notes]


@pytest.fixture
def asked(monkeypatch):
    """Record what `settle` is asked instead of fitting."""
    calls = []

    def record(geometry, _fit_briefly, _progress, *, given):
        calls.append(given)
        open_still = finding(Code.DEPTH_ORDER_OPEN, errors=3.0)
        return replace(geometry, order_errors=3.0, notes=(*geometry.notes, open_still))

    monkeypatch.setattr(fits, "settle", record)
    return calls


def test_an_open_order_is_settled_and_what_is_found_is_taken(first, asked):
    assert settled(first, LONG).geometry.order_errors == 3.0
    assert asked == [False]


def test_depths_of_further_views_take_no_part_in_the_comparison_of_orders(first, monkeypatch):
    begun, beginning = [], fits.Fits.beginning

    def begin(self, look, views, **how):
        begun.append(look.geometry.view_depths)
        return beginning(self, look, views, **how)

    def compare(geometry, fit_briefly, _progress, *, given):
        assert fit_briefly(geometry, 0) > 0
        return geometry

    monkeypatch.setattr(fits.Fits, "beginning", begin)
    monkeypatch.setattr(fits, "settle", compare)
    depths = (ViewDepth(first.geometry.reference, first.geometry.inverse_depth),)
    found = settled(replace(first, geometry=replace(first.geometry, view_depths=depths)), LONG)
    assert begun == [()]
    assert found.geometry.view_depths == depths


def test_a_file_is_told_from_tracks(first, asked):
    settled(replace(first, geometry=replace(first.geometry, source="file")), LONG)
    assert asked == [True]


def test_a_path_without_tracks_is_asked_for_its_order_only_if_its_scene_is_taken(first, asked):
    uniform = replace(first, geometry=replace(first.geometry, source="uniform"))
    assert settled(uniform, LONG) is uniform
    assert asked == []
    made = fits.Fits(first.holdout, first.holdout, None, LONG, lambda views: views, Silent(), Stopwatch())
    note = finding(Code.PATH_FOUND_AGAIN)
    taken = Attempt(uniform, replace(uniform.geometry, notes=(note,)), (), None)
    for other in (from_rest(uniform).geometry, first.geometry, replace(taken.geometry, order_errors=9.0)):
        elsewhere = replace(taken, geometry=other)
        assert made.with_order(uniform, elsewhere) is elsewhere
    assert asked == []
    told = made.with_order(uniform, taken).geometry
    assert (asked, told.order_errors, told.notes) == ([False], 3.0, (note, finding(Code.DEPTH_ORDER_OPEN, errors=3.0)))
    made.halt.begin()
    assert made.halt.ask()
    halted = made.with_order(uniform, taken).geometry
    assert [one.code for one in halted.notes] == [Code.PATH_FOUND_AGAIN, Code.DEPTH_ORDER_UNTRIED]
    assert asked == [False]


def test_a_stage_is_not_asked_for_its_order(first, asked):
    given = replace(first, geometry=replace(first.geometry, source="stage", order_given=True))
    assert settled(given, LONG) is given
    assert asked == []


@pytest.mark.parametrize(
    ("settings", "hurried"),
    [
        (Settings(fit=CoarseSettings(iterations=100)), False),
        (replace(LONG, try_orders=False), False),
        (LONG, True),
    ],
)
def test_without_time_for_short_fits_the_order_is_doubted_unless_it_was_given(first, asked, settings, hurried):
    assert codes(settled(first, settings, hurried=hurried)) == [Code.DEPTH_ORDER_UNTRIED]
    given = replace(first, geometry=replace(first.geometry, source="file"))
    assert codes(settled(given, settings, hurried=hurried)) == []
    assert asked == []


@pytest.mark.parametrize("change", [{"order_errors": 9.0}, {"verdict": "static"}])
def test_what_is_not_open_is_left_alone(first, asked, change):
    sure = replace(first, geometry=replace(first.geometry, **change))
    assert settled(sure, LONG) is sure
    assert asked == []


def test_an_ablation_keeps_its_first_geometry(first, asked):
    assert settled(first, replace(LONG, withheld=Withheld(points=True))) is first
    assert asked == []


def test_fits_of_a_measurement_that_shows_nothing_leave_the_order_open(first, monkeypatch):
    """Views of noise: neither order hides anything."""
    monkeypatch.setattr(order, "_MOST_PAIRS", 1)
    found = settled(first, LONG).geometry
    assert [note.code for note in found.notes] == [Code.DEPTH_ORDER_OPEN]
    assert abs(found.order_errors) < 2


def test_an_attempt_of_one_fit_is_completed_to_what_all_fits_at_once_would_have_been(first):
    settings = Settings(fit=CoarseSettings(iterations=6, surfaces=None, relief=None, hold_out=HoldOut(look_every=3)))
    refine = Refinement(first.holdout, settings.residual)
    made = fits.Fits(first.holdout, first.holdout, None, settings, refine, Silent(), Stopwatch())
    alone = made.attempt(first, first.decoded, How(alone=True))
    assert (len(alone.fits), len(alone.later)) == (1, 1)
    completed, whole = made.completed(alone), made.attempt(first, first.decoded, How())
    assert (len(completed.fits), completed.later) == (2, ())
    np.testing.assert_array_equal(completed.ensemble.views, whole.ensemble.views)
    assert made.completed(whole) is whole


@pytest.mark.parametrize(("off", "fitted"), [(0.0, 0), (2.0, 1)])
def test_a_fit_along_another_path_takes_a_companions_place_unless_their_mean_is_worse(first, monkeypatch, off, fitted):
    settings = Settings(fit=CoarseSettings(iterations=3, surfaces=None, relief=None))
    refine = Refinement(first.holdout, settings.residual)
    made = fits.Fits(first.holdout, first.holdout, None, settings, refine, Silent(), Stopwatch())
    alone = made.attempt(first, first.decoded, How(alone=True))
    # Views of ten bits: the mean of three equal ones is then the same, without rounding.
    coarse = (np.round(alone.fits[0].views * 1024) / 1024).astype(np.float32)
    alone = replace(alone, fits=(replace(alone.fits[0], views=coarse),))
    companions = []

    def count(_fit_one, team, *_):
        companions.extend(team)
        return alone.fits

    monkeypatch.setattr(fits, "fit_together", count)
    leader = alone.fits[0]
    # Off by as much in one view as in the other way in the next, so that no residual puts it right.
    sign = np.array([1, -1, 1, -1], np.float32)[:, None, None, None]
    other = replace(leader, views=leader.views + np.float32(off) * sign)
    completed = made.completed(alone, (leader, other))
    assert (len(companions), completed.later) == (0, ())
    assert completed.fits == ((leader, leader) if off else (leader, leader, other))
    completed = made.completed(alone, (other,))
    assert (len(companions), completed.later) == (fitted, ())
    assert completed.fits == (leader, leader if fitted else other)
    assert completed.ensemble.best is leader


def test_a_fit_that_counts_in_the_mean_alone_neither_leads_nor_is_let_move(first):
    settings = Settings(fit=CoarseSettings(iterations=3, surfaces=None, relief=None), fits=1)
    refine = Refinement(first.holdout, settings.residual)
    made = fits.Fits(first.holdout, first.holdout, None, settings, refine, Silent(), Stopwatch())
    alone = made.attempt(first, first.decoded, How(alone=True))
    # Right views beside poor ones: it would lead if it might.
    right = replace(alone.fits[0], views=first.decoded)
    assert made.completed(alone, (right,)).ensemble.best is right
    beside = made.completed(alone, (replace(right, beside=True),))
    assert beside.ensemble.best is alone.fits[0]
    assert beside.ensemble.averaged == 2
    assert len(made.release(beside).fits) == 1


def test_what_an_attempt_hides_is_asked_of_the_views_given(first):
    settings = Settings(fit=CoarseSettings(iterations=3, surfaces=None, relief=None), fits=1)
    refine = Refinement(first.holdout, settings.residual)
    made = fits.Fits(first.holdout, first.holdout, None, settings, refine, Silent(), Stopwatch())
    alone = made.attempt(first, first.decoded, How(alone=True))
    assert made.occlusion(alone, 0 * alone.fits[0].views).variance == 0
    seen = made.occlusion(alone, refine(alone.fits[0].views))
    assert seen.variance > 0
    assert seen.evidence.shape == (3, 4)


@pytest.mark.parametrize(
    ("change", "codes", "is_open"),
    [
        ({}, (), False),
        ({}, (Code.DEPTH_ORDER_OPEN,), True),
        ({"source": "uniform"}, (), True),
        ({"source": "uniform"}, (Code.DEPTH_ORDER_SHOWN,), False),
        ({"order_errors": 9.0}, (Code.DEPTH_ORDER_OPEN,), False),
        ({"verdict": "static"}, (Code.DEPTH_ORDER_OPEN,), False),
        ({"order_given": True}, (Code.DEPTH_ORDER_OPEN,), False),
    ],
)
def test_an_order_is_open_if_short_fits_left_it_so_or_if_no_tracks_confirm_the_path(first, change, codes, is_open):
    made = fits.Fits(first.holdout, first.holdout, None, LONG, lambda views: views, Silent(), Stopwatch())
    notes = tuple(finding(code, errors=1.0, times=3.0) for code in codes)
    geometry = replace(first.geometry, notes=notes, **change)
    assert made.is_order_open(geometry) is is_open
    assert not replace(made, settings=replace(LONG, try_orders=False)).is_order_open(geometry)


def test_fits_behind_another_camera_matrix_are_averaged_but_not_let_move(first, monkeypatch):
    settings = Settings(fit=CoarseSettings(iterations=3, surfaces=None, relief=None), fits=1)
    refine = Refinement(first.holdout, settings.residual)
    made = fits.Fits(first.holdout, first.holdout, None, settings, refine, Silent(), Stopwatch())
    alone = made.attempt(first, first.decoded, How(alone=True))
    other = replace(alone.fits[0], intrinsics=2 * alone.fits[0].intrinsics)
    both = made.completed(alone, (other,))
    assert both.ensemble.averaged == 2
    assert len(made.release(both).fits) == 1
    # Rendered anew in the middle of masks, it would be seen by a matrix that is not its own.
    smeared = replace(made, mask_moments=object())
    assert smeared.completed(alone, (other,)).fits == alone.fits


@pytest.mark.parametrize("seed", [0, 1, 7])
def test_fits_released_for_motion_have_seeds_of_their_own_and_go_on_along_their_paths(first, monkeypatch, seed):
    settings = Settings(fit=CoarseSettings(iterations=3, surfaces=None, relief=None), seed=seed)
    refine = Refinement(first.holdout, settings.residual)
    made = fits.Fits(first.holdout, first.holdout, None, settings, refine, Silent(), Stopwatch())
    still = made.attempt(first, first.decoded, How())
    whole, asked = fits.fit_coarse, {}

    def watched(**given):
        asked[given["seed"]] = given["geometry"].world_to_camera
        return whole(**given)

    monkeypatch.setattr(fits, "fit_coarse", watched)
    made.release(still)
    team = members(first_gaussians(seed_points(first.geometry, first.decoded, 4)), (Osgr(),), 2, seed)
    assert sorted(asked) == sorted(member.seed for member in team)
    for member, fit in zip(team, still.fits, strict=True):
        np.testing.assert_array_equal(asked[member.seed], fit.world_to_camera)


def test_a_companion_that_runs_away_is_left_out_when_an_attempt_is_completed(first, monkeypatch):
    def run_away(*_):
        raise NumericsError("numbers ran away", remedy="none")

    settings = Settings(fit=CoarseSettings(iterations=3, surfaces=None, relief=None))
    made = fits.Fits(
        first.holdout,
        first.holdout,
        None,
        settings,
        Refinement(first.holdout, settings.residual),
        Silent(),
        Stopwatch(),
    )
    alone = made.attempt(first, first.decoded, How(alone=True))
    monkeypatch.setattr(fits, "fit_together", run_away)
    completed = made.completed(alone)
    assert (completed.fits, completed.later) == (alone.fits, ())
    assert any("left out: numbers ran away" in said for said in made.progress.sentences)
