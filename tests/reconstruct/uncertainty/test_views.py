from dataclasses import replace

import numpy as np
import pytest

from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.measurement.noise import noise_of_readings
from gs2ci.reconstruct.uncertainty.views import ViewsMade, errors_alike
from gs2ci.reconstruct.uncertainty.views import errors_of_views as found_errors

APART = np.eye(6)


def errors_of_views(holdout: Holdout, views: ViewsMade, alike: np.ndarray) -> np.ndarray:
    return found_errors(holdout, views, alike, noise_of_readings(holdout, views.scene))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


@pytest.mark.parametrize("error", [0.01, 0.05])
def test_errors_of_a_size_that_only_the_readings_tell_are_stated_about_right(measured, error):
    holdout, views, true = measured(error)
    stated = errors_of_views(holdout, views, APART)
    assert stated.shape == true.shape[:3]
    assert stated.dtype == np.float32
    assert 0.5 < rms(stated) / rms(views.delivered - true) < 2


def test_twice_the_error_is_stated_as_twice_the_error(measured):
    once, twice = (rms(errors_of_views(*measured(error)[:2], APART)) for error in (0.02, 0.04))
    assert twice == pytest.approx(2 * once, rel=0.05)


def test_where_the_residual_is_large_views_are_less_sure(measured):
    holdout, views, _ = measured(0.01)
    worse = views.scene.copy()
    worse[:, :, 16:] += 0.1 * np.random.default_rng(3).standard_normal(worse[:, :, 16:].shape).astype(np.float32)
    stated = errors_of_views(holdout, replace(views, delivered=worse, scene=worse), APART)
    assert stated[:, :, 20:].mean() > 2 * stated[:, :, :12].mean()


def test_where_fits_disagree_views_are_less_sure(measured):
    holdout, views, _ = measured()
    apart = np.full(views.delivered.shape[:3], 0.001, np.float32)
    apart[:, :12] = 0.05
    stated = errors_of_views(holdout, replace(views, disagreement=apart), APART)
    assert stated[:, :12].mean() > 1.2 * stated[:, 12:].mean()


def test_a_view_is_surer_where_its_own_mask_is_open(measured):
    holdout, views, _ = measured()
    stated = errors_of_views(holdout, views, APART)
    masks = holdout.shot.masks > 0
    alone = masks.sum(axis=0) == 1
    assert stated[masks & alone].mean() < 0.8 * stated[~masks & alone].mean()


def test_errors_that_views_share_add_up_in_the_readings(measured):
    holdout, views, _ = measured()
    together = errors_of_views(holdout, views, np.ones((6, 6)))
    assert rms(together) < rms(errors_of_views(holdout, views, APART))


def test_a_residual_that_is_mostly_noise_is_not_all_error(measured):
    quiet, loud = measured(0.02), measured(0.02, noise=0.2)
    stated = [rms(errors_of_views(holdout, views, APART)) for holdout, views, _ in (quiet, loud)]
    assert stated[1] < 0.6 * 0.2
    assert stated[1] > stated[0]


def test_without_held_out_pixels_the_others_stand_for_them(measured):
    holdout, views, true = measured(share=0.0)
    assert not holdout.pixels.any()
    assert 0.5 < rms(errors_of_views(holdout, views, APART)) / rms(views.delivered - true) < 3


def test_one_view_alone_has_standard_errors(measured):
    holdout, views, _ = measured(count=1)
    stated = errors_of_views(holdout, views, np.ones((1, 1)))
    assert np.isfinite(stated).all()
    assert stated.min() > 0


def test_views_that_explain_every_reading_are_stated_as_exact(measured):
    holdout, views, true = measured()
    coded = holdout.coded(true)
    exact = replace(views, delivered=true, scene=true)
    shot = replace(holdout.shot, measurement=coded)
    assert not errors_of_views(Holdout(shot, holdout.pixels), exact, APART).any()


def test_without_a_usable_reading_nothing_is_known(measured):
    holdout, views, _ = measured()
    blind = replace(holdout.shot, saturated=np.ones(holdout.shot.size, bool))
    assert np.all(errors_of_views(Holdout(blind, np.zeros(blind.size, bool)), views, APART) == np.float32(0.3))


def test_errors_are_alike_where_the_picture_does_not_move():
    flow = np.zeros((2, 2, 3))
    flow[0, 1] = flow[1, 0] = (0.0, 1.0, 1e6)
    alike = errors_alike(flow)
    assert np.allclose(np.diag(alike), 1)
    assert alike[0, 1] == pytest.approx((1 + np.exp(-0.5) + 0) / 3)
