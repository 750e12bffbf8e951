"""What is put back of a residual: against measurements whose noise is known."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import RESIDUAL, decode_residual
from gs2ci.reconstruct.fit.combining.refinement import Refinement
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.measurement.noise import noise_of_readings

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


@pytest.mark.parametrize("noise", [None, 0.02])
def test_the_noise_that_the_views_tell_is_weighed_unless_it_is_known(truth, noise):
    holdout, views = holdout_of(truth, noise=0.1), truth - np.float32(0.1)
    known = None if noise is None else np.full_like(holdout.shot.measurement, noise)
    weighed = noise_of_readings(holdout, views) if known is None else known
    refine = Refinement(holdout, SETTINGS, known)
    np.testing.assert_array_equal(refine(views), views + decode_residual(holdout.seen, views, SETTINGS, weighed))
    by_all = views + decode_residual(holdout.shot, views, SETTINGS, weighed)
    np.testing.assert_array_equal(refine.by_all_pixels(views), by_all)


def test_held_out_pixels_are_seen_only_where_nothing_is_left_to_judge(truth):
    holdout, views = holdout_of(truth), truth - np.float32(0.1)
    measurement = holdout.shot.measurement.copy()
    measurement[holdout.pixels] = holdout.coded(views)[holdout.pixels]  # as if nothing were lacking there
    other = Holdout(replace(holdout.shot, measurement=measurement), holdout.pixels)
    np.testing.assert_array_equal(Refinement(other, SETTINGS)(views), Refinement(holdout, SETTINGS)(views))
    grain = 0.1 * np.random.default_rng(1).standard_normal((*SIZE, 1)).astype(np.float32)  # no neighbour tells of it
    unseen = Refinement(holdout, SETTINGS)(truth - grain)
    seen = Refinement(holdout, SETTINGS).by_all_pixels(truth - grain)
    assert rms((seen - truth)[:, holdout.pixels]) < 0.97 * rms((unseen - truth)[:, holdout.pixels])


def test_nothing_is_put_back_without_settings(truth):
    holdout = holdout_of(truth)
    refine = Refinement(holdout, None)
    assert refine(truth) is refine.by_all_pixels(truth) is truth
    assert refine.decode(holdout.coded(truth)) is None


def test_settings_that_make_no_sense_are_refused(truth):
    with pytest.raises(InputError, match="in GapTvSettings"):
        Refinement(holdout_of(truth), replace(SETTINGS, iterations=0))
