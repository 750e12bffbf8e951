"""How much of a decoded residual is put back: against measurements whose noise is known."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import RESIDUAL, decode_residual
from gs2ci.reconstruct.fit.combining.refinement import Refinement
from gs2ci.reconstruct.measurement.holdout import SURE, Holdout

SETTINGS = RESIDUAL
SIZE = (64, 80)


@pytest.fixture
def truth():
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] / 10
    base = 0.5 + 0.3 * np.sin(x[None] + 0.3 * np.arange(4)[:, None, None]) * np.cos(y[None])
    return np.repeat(base[..., None], 3, axis=3).astype(np.float32)


def holdout_of(truth, *, noise=0.0, share=0.1, seed=0):
    rng = np.random.default_rng(seed)
    masks = (rng.random((4, *SIZE)) < 0.4).astype(np.float32)
    measurement = (masks[..., None] * truth).sum(axis=0) + noise * rng.standard_normal((*SIZE, 3))
    shot = Shot(measurement.astype(np.float32), masks, np.ones(4, np.float32)).check()
    return Holdout.of(shot, share, 0)


def rms(error):
    return float(np.sqrt(np.mean(error**2)))


def test_what_smooth_views_lack_is_put_back(truth):
    flat = np.full_like(truth, truth.mean())
    refined = Refinement(holdout_of(truth), SETTINGS)(flat)
    assert rms(refined - truth) < 0.5 * rms(flat - truth)
    assert refined.dtype == np.float32


def test_of_a_residual_that_is_only_noise_little_is_put_back(truth):
    holdout = holdout_of(truth, noise=0.2)
    wholly = truth + decode_residual(holdout.seen, truth, SETTINGS)
    refined = Refinement(holdout, SETTINGS)(truth)
    assert rms(refined - truth) < 0.5 * rms(wholly - truth)
    np.testing.assert_array_equal(truth + Refinement(holdout, SETTINGS).decode(holdout.coded(truth)), wholly)


@pytest.mark.parametrize("settings", [SETTINGS, None])
def test_both_ways_from_one_decode_are_those_by_themselves(truth, settings):
    holdout, flat = holdout_of(truth, noise=0.05), np.full_like(truth, truth.mean())
    refine = Refinement(holdout, settings)
    in_full, by_share = refine.in_full_and_by_share(flat)
    added = np.float32(0) if settings is None else refine.decode(holdout.coded(flat))
    np.testing.assert_array_equal(in_full, flat + added)
    np.testing.assert_array_equal(by_share, refine(flat))


def test_the_share_is_that_of_least_squares_where_nothing_is_left_open(truth):
    holdout = holdout_of(truth)
    lacking = np.float32(0.1) * np.sin(np.arange(truth.size)).reshape(truth.shape).astype(np.float32)
    for true_share in (0.0, 0.3, 0.8):
        share = Refinement(holdout, SETTINGS).share(truth - np.float32(true_share) * lacking, lacking)
        assert share == pytest.approx(true_share, abs=1e-4)


def test_the_share_is_rarely_less_than_the_true_one(truth):
    lacking = np.float32(0.2) * np.sin(np.arange(truth.size)).reshape(truth.shape).astype(np.float32)
    views = truth - np.float32(0.4) * lacking
    shares = [Refinement(holdout_of(truth, noise=0.3, seed=seed), SETTINGS).share(views, lacking) for seed in range(60)]
    assert np.mean(np.array(shares) < 0.4) < 0.1
    assert np.std(shares) > 0.02
    assert np.median(shares) < 0.4 + 2 * SURE * np.std(shares)


def test_the_share_stays_between_nothing_and_all(truth):
    refinement, lacking = Refinement(holdout_of(truth), SETTINGS), np.full_like(truth, 0.01)
    assert refinement.share(truth + np.float32(1), lacking) == 0
    assert refinement.share(truth - np.float32(1), lacking) == 1


@pytest.mark.parametrize("added", [0.0, np.nan, np.inf])
def test_nothing_and_what_is_not_finite_decide_nothing(truth, added):
    assert Refinement(holdout_of(truth), SETTINGS).share(truth, np.full_like(truth, added)) == 1


def test_without_held_out_pixels_all_is_put_back(truth):
    holdout, views = holdout_of(truth, share=0.0), truth - np.float32(0.1)
    expected = views + decode_residual(holdout.shot, views, SETTINGS)
    np.testing.assert_array_equal(Refinement(holdout, SETTINGS)(views), expected)
    np.testing.assert_array_equal(Refinement(holdout, SETTINGS).by_all_pixels(views), expected)


def test_held_out_pixels_decide_the_share_and_are_seen_only_where_nothing_is_left_to_judge(truth):
    holdout, views = holdout_of(truth), truth - np.float32(0.1)
    measurement = holdout.shot.measurement.copy()
    measurement[holdout.pixels] = holdout.coded(views)[holdout.pixels]  # as if nothing were lacking there
    other = Holdout(replace(holdout.shot, measurement=measurement), holdout.pixels)
    added = decode_residual(holdout.seen, views, SETTINGS)
    np.testing.assert_array_equal(decode_residual(other.seen, views, SETTINGS), added)
    low, high = Refinement(other, SETTINGS).share(views, added), Refinement(holdout, SETTINGS).share(views, added)
    assert low < 0.4 < high
    grain = 0.1 * np.random.default_rng(1).standard_normal((*SIZE, 1)).astype(np.float32)  # no neighbour tells of it
    unseen = Refinement(holdout, SETTINGS)(truth - grain)
    seen = Refinement(holdout, SETTINGS).by_all_pixels(truth - grain)
    assert rms((seen - truth)[:, holdout.pixels]) < 0.97 * rms((unseen - truth)[:, holdout.pixels])


def test_settings_that_make_no_sense_are_refused(truth):
    with pytest.raises(InputError, match="in GapTvSettings"):
        Refinement(holdout_of(truth), replace(SETTINGS, iterations=0))
