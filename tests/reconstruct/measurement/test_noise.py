"""The power of the readings' noise, against noise that was drawn."""

from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.reconstruct.measurement.noise import followed, mean_power, noise_of_readings

SIZE, VIEWS = (48, 64), 6
# A fit follows some of the noise, for which the estimate makes up; the truth follows none.
FOLLOWED = 1.1


def views_of(channels=1):
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]] / SIZE[1]
    views = [0.5 + 0.3 * np.sin(6 * columns + 0.3 * k) * np.cos(5 * rows) for k in range(VIEWS)]
    return np.stack(views).astype(np.float32)[..., None].repeat(channels, axis=3)


def holdout_of(views, power_of):
    """Readings with noise whose power follows from the light, by a function."""
    rng = np.random.default_rng(0)
    masks = (rng.random((VIEWS, *SIZE)) < 0.4).astype(np.float32)
    light = np.einsum("nhw,nhwc->hwc", masks, views)
    readings = light + np.sqrt(power_of(light)) * rng.standard_normal(light.shape)
    return Holdout.of(Shot(readings.astype(np.float32), masks).check(), 0.3, 0), light


@pytest.mark.parametrize("noise", [0.02, 0.2])
@pytest.mark.parametrize("channels", [1, 3])
def test_the_noise_is_told_also_where_a_model_is_wrong_in_places(noise, channels):
    views = views_of(channels)
    holdout, _ = holdout_of(views, lambda light: noise**2)
    wrong = views.copy()
    wrong[:, 10:20, 10:20] += 0.5
    found = noise_of_readings(holdout, wrong)
    assert found.shape == holdout.shot.measurement.shape
    assert found.dtype == np.float32
    assert mean_power(found, holdout) == pytest.approx(FOLLOWED * noise**2, rel=0.15)


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_what_a_fit_has_followed_counts_as_noise_on_the_average(share):
    views, noise = views_of(3), 0.1
    holdout, light = holdout_of(views, lambda light: noise**2)
    # At pixels that it saw it follows a share of their noise; it errs by as much where it saw nothing.
    strange = np.random.default_rng(1).normal(0, np.sqrt((1 - share) ** -2 - 1) * noise, light.shape)
    change = np.where(holdout.pixels[..., None], strange, share * (holdout.shot.measurement - light))
    masks = holdout.shot.masks
    fit = (views + masks[..., None] * (change / np.maximum(masks.sum(axis=0), 1)[..., None])).astype(np.float32)
    found = mean_power(noise_of_readings(holdout, fit), holdout) * followed(holdout, fit)
    assert found == pytest.approx(noise**2, rel=0.15)
    assert followed(holdout, views) == pytest.approx(1, abs=0.1)


def test_bright_readings_have_the_noise_of_their_photons():
    views = views_of(3)
    holdout, light = holdout_of(views, lambda light: 0.01 * light)
    found = noise_of_readings(holdout, views)
    for least, most in ((0.5, 1.0), (1.0, 1.5), (1.5, 2.5)):
        lit = (light >= least) & (light < most)
        assert found[lit].mean() == pytest.approx(FOLLOWED * 0.01 * light[lit].mean(), rel=0.25)


def test_there_is_no_noise_where_no_pixel_can_tell():
    views = views_of()
    holdout, _ = holdout_of(views, lambda light: 0.01)
    clipped = Holdout(replace(holdout.shot, saturated=np.ones(SIZE, bool)), np.zeros(SIZE, bool))
    found = noise_of_readings(clipped, views)
    assert not found.any()
    assert mean_power(found, clipped) == 0.0
    assert followed(clipped, views) == 1.0


def test_a_picture_of_few_pixels_has_one_class():
    masks = np.ones((2, 3, 4), np.float32)
    views = np.full((2, 3, 4, 1), 0.5, np.float32)
    readings = 1 + 0.1 * np.random.default_rng(0).standard_normal((3, 4, 1)).astype(np.float32)
    found = noise_of_readings(Holdout(Shot(readings, masks).check(), np.zeros((3, 4), bool)), views)
    assert np.ptp(found) == 0
    assert found[0, 0, 0] > 0


def test_a_colour_filter_array_has_one_reading_at_each_pixel():
    views = views_of(3)
    rng = np.random.default_rng(0)
    masks = (rng.random((VIEWS, *SIZE)) < 0.4).astype(np.float32)
    shot = Shot(np.zeros((*SIZE, 1), np.float32), masks, cfa="RGGB").check()
    light = Holdout(shot, np.zeros(SIZE, bool)).coded(views)
    readings = (light + 0.05 * rng.standard_normal(light.shape)).astype(np.float32)
    found = noise_of_readings(Holdout(replace(shot, measurement=readings), np.zeros(SIZE, bool)), views)
    assert found.shape == (*SIZE, 1)
    assert found.mean() == pytest.approx(FOLLOWED * 0.05**2, rel=0.25)
