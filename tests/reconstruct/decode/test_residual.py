from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.decode.gap_tv import RESIDUAL, decode_residual

SETTINGS = RESIDUAL


@pytest.fixture
def truth():
    y, x = np.mgrid[:32, :40] / 10
    base = 0.5 + 0.3 * np.sin(x[None] + 0.3 * np.arange(4)[:, None, None]) * np.cos(y[None])
    return np.repeat(base[..., None], 3, axis=3).astype(np.float32)


@pytest.fixture
def shot(truth):
    masks = (np.random.default_rng(0).random((4, 32, 40)) < 0.4).astype(np.float32)
    return Shot((masks[..., None] * truth).sum(axis=0), masks, np.ones(4, np.float32)).check()


def with_residual(shot, views, settings):
    return views + decode_residual(shot, views, settings)


def rms(error):
    return float(np.sqrt(np.mean(error**2)))


def test_views_that_explain_the_measurement_are_left_alone(shot, truth):
    np.testing.assert_allclose(with_residual(shot, truth, SETTINGS), truth, atol=1e-5)


def test_what_the_scene_lacks_is_put_back_whichever_its_sign(shot, truth):
    for sign in (-1, 1):
        flawed = truth.copy()
        flawed[:, 10:20, 10:25] += np.float32(0.2 * sign)
        refined = with_residual(shot, flawed, SETTINGS)
        assert rms(refined - truth) < 0.6 * rms(flawed - truth)


def test_the_residual_is_not_clamped_to_the_range_of_light(shot, truth):
    bright = replace(shot, measurement=3 * shot.measurement)
    refined = with_residual(bright, truth, SETTINGS)
    assert rms(refined - 3 * truth) < 0.2 * rms(2 * truth)
    assert refined.max() > 1.5
    assert refined.dtype == np.float32


def test_pixels_that_cannot_be_seen_take_the_correction_of_their_surroundings(shot, truth):
    masks, measurement = shot.masks.copy(), shot.measurement.copy()
    masks[:, 15, 15], measurement[15, 15] = 0, 0
    refined = with_residual(replace(shot, masks=masks, measurement=measurement), truth + np.float32(0.2), SETTINGS)
    assert np.isfinite(refined).all()
    assert rms(refined[:, 15, 15] - truth[:, 15, 15]) < 0.2


def test_saturated_pixels_count_for_nothing(shot, truth):
    """With no pixel that counts, the residual of a scene as bright as the measurement says decodes to nothing."""
    everywhere = replace(shot, saturated=np.ones((32, 40), bool))
    np.testing.assert_allclose(with_residual(everywhere, truth, SETTINGS), truth, atol=1e-5)


def test_one_saturated_pixel_is_not_believed(shot, truth):
    measurement, saturated = shot.measurement.copy(), np.zeros((32, 40), bool)
    measurement[16, 20], saturated[16, 20] = 0, True
    believed = with_residual(replace(shot, measurement=measurement), truth, SETTINGS)
    doubted = with_residual(replace(shot, measurement=measurement, saturated=saturated), truth, SETTINGS)
    assert rms(doubted - truth) < 0.5 * rms(believed - truth)


def test_arguments_are_not_changed(shot, truth):
    views = truth + np.float32(0.1)
    before = views.copy(), shot.measurement.copy()
    with_residual(shot, views, SETTINGS)
    np.testing.assert_array_equal(views, before[0])
    np.testing.assert_array_equal(shot.measurement, before[1])


@pytest.mark.parametrize("settings", [{"iterations": 0}, {"weight": 0.0}, {"inner": 0}])
def test_settings_that_make_no_sense_are_refused(shot, truth, settings):
    with pytest.raises(InputError, match="in GapTvSettings"):
        with_residual(shot, truth, replace(SETTINGS, **settings))


def test_views_that_do_not_fit_the_shot_are_refused(shot, truth):
    with pytest.raises(InputError, match="shape"):
        with_residual(shot, truth[:3], SETTINGS)
