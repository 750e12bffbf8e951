from dataclasses import replace

import numpy as np
import pytest

from gs2ci.core.errors import InputError, NumericsError
from gs2ci.evaluate.metrics import psnr_per_view
from gs2ci.reconstruct.decode.denoisers import TotalVariation
from gs2ci.reconstruct.decode.pnp import PlugAndPlaySettings, ReadingNoise, plug_and_play
from gs2ci.reconstruct.measurement.coding import cfa_channels


def halfway(views, sigma):
    """A denoiser that is easy to state: half of the way to the mean of each plane, weighed by sigma."""
    return views + 0.5 * sigma * (views.mean(axis=(2, 3), keepdims=True) - views)


def reference(shot, settings):
    """The scheme as its paper states it, float64, for pixels that some binary mask opens."""
    masks, y = shot.masks.astype(float)[:, None], shot.measurement.astype(float).transpose(2, 0, 1)
    energy = (masks**2).sum(0)
    views = np.repeat((y / masks.sum(0))[None], len(masks), axis=0)
    y1 = np.zeros_like(y)
    for sigma in np.repeat(settings.sigmas, settings.iterations):
        predicted = (masks * views).sum(0)
        y1 = y1 + (y - predicted)
        views = halfway(views + masks * (y1 - predicted) / energy, sigma)
    return views.transpose(0, 2, 3, 1)


@pytest.mark.parametrize("channels", [1, 3])
def test_the_scheme_is_that_of_its_paper(make_shot, channels):
    shot = opened(make_shot(channels=channels))
    settings = PlugAndPlaySettings(sigmas=(0.3, 0.1), iterations=4)
    np.testing.assert_allclose(plug_and_play(shot, halfway, settings), reference(shot, settings), atol=2e-5)


def weighed_reference(shot, power, start, sigmas, error_power):
    """GAP whose steps weigh noise against errors, float64, as `ReadingNoise` states it."""
    masks, y = shot.masks.astype(float)[:, None], shot.measurement.astype(float).transpose(2, 0, 1)
    energy, power = (masks**2).sum(0), power.astype(float).transpose(2, 0, 1)
    views, accumulated = start.astype(float).transpose(0, 3, 1, 2), np.zeros_like(y)
    for sigma in sigmas:
        left = y - (masks * views).sum(0)
        ratio = np.full_like(y, np.inf)  # 1 + κ
        np.divide(error_power(sigma) * energy, power, out=ratio, where=power > 0)
        accumulated = np.maximum(0, 1 - 1 / ratio) * (accumulated + left)
        views = halfway(views + np.minimum(1, ratio) * masks * (left + accumulated) / energy, sigma)
    return views.transpose(0, 2, 3, 1)


def opened(shot):
    """The shot, with a mask that opens all pixels that no other one does."""
    masks = shot.masks.copy()
    masks[0][masks.sum(0) == 0] = 1
    return replace(shot, masks=masks)


@pytest.mark.parametrize("channels", [1, 3])
def test_noise_is_weighed_as_stated(make_shot, channels):
    shot = opened(make_shot(channels=channels))
    rng = np.random.default_rng(0)
    # From none to more than the errors, so that the step is shortened at some pixels and accumulated at others.
    power = 0.03 * rng.integers(0, 3, shot.measurement.shape) * rng.random(shot.measurement.shape)
    start = rng.random(shot.truth.views.shape).astype(np.float32)
    settings = PlugAndPlaySettings(sigmas=(0.2, 0.1, 0.05), iterations=2)
    noise = ReadingNoise(power.astype(np.float32), lambda sigma: 2 * sigma**2)
    got = plug_and_play(shot, halfway, settings, start=start, noise=noise)
    levels = np.repeat(settings.sigmas, settings.iterations)
    expected = weighed_reference(shot, power, start, levels, noise.error_power)
    np.testing.assert_allclose(got, expected, atol=2e-5)


def test_no_noise_changes_nothing(make_shot):
    shot = make_shot(channels=3)
    start = np.full_like(shot.truth.views, 0.4)
    none = ReadingNoise(np.zeros_like(shot.measurement), lambda sigma: sigma**2)
    weighed, plain = (plug_and_play(shot, TotalVariation(), start=start, noise=noise) for noise in (none, None))
    np.testing.assert_array_equal(weighed, plain)


def test_weighed_noise_is_not_taken_into_the_views(make_shot):
    """A decode that knows the noise errs less than one that explains every reading."""
    shot = make_shot(channels=3, slide=0.4)
    noise = 0.3
    readings = shot.measurement + noise * np.random.default_rng(3).standard_normal(shot.measurement.shape)
    shot = replace(shot, measurement=readings.astype(np.float32))
    known = ReadingNoise(np.full_like(shot.measurement, noise**2), lambda sigma: 0.1 * sigma)
    error = [
        np.mean((plug_and_play(shot, TotalVariation(1.0), noise=one) - shot.truth.views) ** 2) for one in (known, None)
    ]
    assert error[0] < 0.7 * error[1]


@pytest.mark.parametrize("kind", ["mono", "rgb", "mosaic", "grey"])
def test_views_come_closer_to_the_truth_than_their_average(make_shot, kind):
    shot = make_shot(
        channels=3 if kind == "rgb" else 1, slide=0.4, cfa="RGGB" if kind == "mosaic" else None, grey=kind == "grey"
    )
    settings = PlugAndPlaySettings(iterations=5)
    views = plug_and_play(shot, TotalVariation(), settings)
    truth = shot.truth.views
    assert views.shape == truth.shape
    average = np.repeat(truth.mean(axis=0, keepdims=True), len(truth), axis=0)
    gain = 1 if kind == "mosaic" else 3  # demosaicking bounds what a mosaic can reach
    assert np.mean(psnr_per_view(views, truth)) > np.mean(psnr_per_view(average, truth)) + gain


def test_saturated_and_closed_pixels_cannot_spoil_the_views(make_shot):
    saturated = np.zeros((32, 40), bool)
    saturated[5:8, 5:8] = True
    clean = make_shot(saturated=saturated)
    masks, measured = clean.masks.copy(), clean.measurement.copy()
    masks[:, 20:22, 20:22] = 0
    spoilt = measured.copy()
    spoilt[saturated] = 1e6
    spoilt[20:22, 20:22] = 1e6
    settings = PlugAndPlaySettings(iterations=3)
    views = [
        plug_and_play(type(clean)(y, masks, clean.weights, saturated=saturated).check(), TotalVariation(), settings)
        for y in (measured, spoilt)
    ]
    assert np.array_equal(*views)
    assert np.abs(views[0]).max() < 1.5


def test_sigma_falls_as_the_schedule_says(make_shot):
    heard = []

    def listen(views, sigma):
        heard.append(sigma)
        return views

    plug_and_play(make_shot(), listen, PlugAndPlaySettings(sigmas=(0.2, 0.1), iterations=2))
    assert heard == [0.2, 0.2, 0.1, 0.1]


def test_a_mosaic_is_projected_as_it_was_measured(make_shot):
    shot = make_shot(cfa="GBRG")
    seen = []

    def listen(views, sigma):
        seen.append(views.shape)
        return views

    views = plug_and_play(shot, listen, PlugAndPlaySettings(sigmas=(0.1,), iterations=8))
    assert set(seen) == {(4, 3, 32, 40)}
    channels = np.broadcast_to(cfa_channels("GBRG", shot.size).numpy()[None, ..., None], (4, 32, 40, 1))
    mosaics = np.take_along_axis(views, channels, axis=3)
    np.testing.assert_allclose(
        (shot.masks[..., None] * mosaics).sum(0)[shot.masks.any(0)], shot.measurement[shot.masks.any(0)], atol=1e-3
    )


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_denoiser_that_leaves_the_finite_numbers_is_named(make_shot, value):
    def broken(views, sigma):
        views[1, 0, 3, 3] = value
        return views

    with pytest.raises(NumericsError, match=r"not finite at sigma 0\.1961"):
        plug_and_play(make_shot(), broken)


def test_a_denoiser_that_changes_the_shape_is_named(make_shot):
    with pytest.raises(NumericsError, match=r"\[4, 1, 32, 39\] of \[4, 1, 32, 40\]"):
        plug_and_play(make_shot(), lambda views, sigma: views[..., :-1])


@pytest.mark.parametrize(
    "wrong",
    [
        {"sigmas": ()},
        {"sigmas": (0.1, 0.0)},
        {"sigmas": (np.nan,)},
        {"iterations": 0},
    ],
)
def test_settings_that_make_no_sense_are_refused(make_shot, wrong):
    with pytest.raises(InputError, match=f"{next(iter(wrong))} = .* in PlugAndPlaySettings"):
        plug_and_play(make_shot(), halfway, PlugAndPlaySettings(**wrong))
