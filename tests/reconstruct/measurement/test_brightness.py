"""The brightness of views, against measurements that were lit otherwise than their weights say."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.brightness import (
    Brightness,
    BrightnessEstimate,
    BrightnessSettings,
    LinearSystem,
    estimate,
    relit,
)
from gs2ci.reconstruct.measurement.holdout import Holdout
from gs2ci.render.places import working_on
from tests.render.pretended_card import CARD, pretended_card

SIZE = (40, 48)
LIGHT = np.array([0.7, 1.0, 1.3, 1.1, 0.9])
SETTINGS = BrightnessSettings()
GAIN = SETTINGS.least_gain


def views_of(channels=3, seed=0):
    return np.random.default_rng(seed).uniform(0.1, 0.9, (len(LIGHT), *SIZE, channels)).astype(np.float32)


def shot_of(views, light=LIGHT, *, grey=False, noise=0.0, **parts):
    rng = np.random.default_rng(1)
    drawn = rng.random((len(views), *SIZE))
    masks = (drawn if grey else drawn < 0.4).astype(np.float32)
    measurement = np.einsum("n,nhw,nhwc->hwc", light, masks, views) + noise * rng.standard_normal(views.shape[1:])
    return replace(Shot(measurement.astype(np.float32), masks, np.ones(len(views), np.float32)), **parts).check()


def holdout_of(shot, share=0.05):
    return Holdout.of(shot, share, 0)


def view_brightness(shot, views):
    system = LinearSystem.of(shot, views)
    found = None if system is None else system.solve()
    return None if found is None else system.of_all_views(found)


def corrected_of(holdout, views):
    """The measurement with corrected weights, where they are surely wrong; else None."""
    found = estimate(holdout, views)
    return relit(holdout, found) if found is not None and found.is_sure(SETTINGS) else None


def gain_of(shot, views):
    return LinearSystem.of(shot, views).gain()


@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize("channels", [1, 3])
def test_brightness_is_found_up_to_its_mean(grey, channels):
    views = views_of(channels)
    found = view_brightness(shot_of(views, grey=grey), views)
    np.testing.assert_allclose(found / found.mean(), LIGHT / LIGHT.mean(), rtol=1e-5)


def test_the_mean_over_the_light_of_the_masks_stays_what_the_weights_say():
    views = views_of()
    weights = np.array([1.0, 0.5, 2.0, 1.0, 1.5], np.float32)
    shot = shot_of(views, weights=weights)
    light = weights * shot.masks.sum(axis=(1, 2))
    assert (view_brightness(shot, views) * light).sum() == pytest.approx(light.sum())


def test_a_colour_mosaic_tells_as_well():
    views = views_of()
    plain = shot_of(views)
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    channel = (rows % 2) + (columns % 2)  # RGGB
    mosaic = np.take_along_axis(plain.measurement, channel[..., None], axis=2)
    found = view_brightness(replace(plain, measurement=mosaic, cfa="RGGB").check(), views)
    np.testing.assert_allclose(found / found.mean(), LIGHT / LIGHT.mean(), rtol=1e-5)


def test_noise_leaves_the_brightness_within_its_standard_errors():
    views = views_of()
    found = view_brightness(shot_of(views, noise=0.1), views)
    np.testing.assert_allclose(found / found.mean(), LIGHT / LIGHT.mean(), atol=0.02)


def test_saturated_pixels_do_not_count():
    views = views_of()
    shot = shot_of(views)
    saturated = np.zeros(SIZE, bool)
    saturated[:20] = True
    clipped = np.where(saturated[..., None], np.float32(0.2), shot.measurement)
    found = view_brightness(replace(shot, measurement=clipped, saturated=saturated), views)
    np.testing.assert_allclose(found / found.mean(), LIGHT / LIGHT.mean(), rtol=1e-5)


def test_a_view_that_no_light_reached_keeps_its_weight():
    views = views_of()
    shot = shot_of(views)
    masks = shot.masks.copy()
    masks[2] = 0
    measurement = np.einsum("n,nhw,nhwc->hwc", LIGHT, masks, views).astype(np.float32)
    found = view_brightness(replace(shot, masks=masks, measurement=measurement), views)
    others = [0, 1, 3, 4]
    assert found[2] == 1
    np.testing.assert_allclose(found[others] / found[others].mean(), LIGHT[others] / LIGHT[others].mean(), rtol=1e-5)


def test_masks_that_do_not_tell_views_apart_tell_no_brightness():
    views = np.repeat(views_of()[:1], len(LIGHT), axis=0)
    shot = shot_of(views)
    alike = replace(shot, masks=np.repeat(shot.masks[:1], len(LIGHT), axis=0))
    assert view_brightness(alike, views) is None


def pairs_of_masks(pairs=3):
    """Masks that are open where the other one of their pair is closed, as DMDs show them."""
    drawn = (np.random.default_rng(1).random((pairs, *SIZE)) < 0.5).astype(np.float32)
    return np.stack([drawn, 1 - drawn], axis=1).reshape(-1, *SIZE)


def test_pairs_of_complementary_masks_tell_the_light_within_a_pair_and_never_that_of_a_pair_against_another():
    """Each pair passes all of the light once, so that a stronger one and a weaker one pass what two alike do."""
    masks = pairs_of_masks()
    light = np.array([0.8, 1.2, 1.1, 0.9, 1.0, 1.0])
    rng = np.random.default_rng(2)
    still = np.repeat(views_of()[:1], 6, axis=0)
    views = still + 0.03 * gaussian_filter(rng.standard_normal(still.shape), (0, 4, 4, 0))
    readings = np.einsum("n,nhw,nhwc->hwc", light, masks, views).astype(np.float32)
    shot = Shot(readings, masks, np.ones(6, np.float32)).check()
    # What is predicted carries the errors of a decode: they pass for light where nothing else tells it.
    predicted = (still + 0.03 * gaussian_filter(rng.standard_normal(still.shape), (0, 4, 4, 0))).astype(np.float32)
    assert view_brightness(shot, predicted) == pytest.approx(light, abs=0.02)
    between = [LinearSystem.of(shot, predicted).solve()[2 * pair : 2 * pair + 2].sum() for pair in range(3)]
    assert between == pytest.approx([2.0] * 3, abs=0.01)
    errors = LinearSystem.of(shot, predicted).errors()
    assert errors.shape == (6,)
    assert 0 < errors.min() <= errors.max() < 0.02


def test_black_views_and_measurements_without_a_usable_pixel_or_a_second_view_tell_none():
    views = views_of()
    shot = shot_of(views)
    assert view_brightness(shot, np.zeros_like(views)) is None
    assert view_brightness(replace(shot, measurement=np.zeros_like(shot.measurement)), views) is None
    assert view_brightness(replace(shot, saturated=np.ones(SIZE, bool)), views) is None
    one = replace(shot, masks=shot.masks[:1], weights=shot.weights[:1])
    assert view_brightness(one, views[:1]) is None
    assert view_brightness(shot, np.full_like(views, np.nan)) is None


def test_brightness_beyond_any_lamp_is_not_believed():
    views = views_of()
    assert view_brightness(shot_of(views, np.array([1, 1, 1, 1, 0.01])), views) is None
    assert view_brightness(shot_of(views, np.array([1, 1, 1, 1, -0.5])), views) is None


def test_wrong_weights_are_corrected_and_pixels_that_were_not_asked_agree():
    views = views_of()
    holdout = holdout_of(shot_of(views))
    corrected = corrected_of(holdout, views)
    np.testing.assert_allclose(corrected.shot.weights / corrected.shot.weights.mean(), LIGHT / LIGHT.mean(), rtol=1e-3)
    assert corrected.shot.weights.dtype == np.float32
    np.testing.assert_array_equal(corrected.pixels, holdout.pixels)
    assert corrected.residual_rms(views * 1) < 0.3 * holdout.residual_rms(views)
    assert gain_of(holdout.seen, views) > 0.5


def test_wrong_weights_are_corrected_though_the_views_explain_little_besides():
    """What the carried views leave otherwise is ten times what the lamp changes, as with a path that is not known."""
    views = views_of()
    light = 1 + 0.3 * (LIGHT - LIGHT.mean())
    corrected = corrected_of(holdout_of(shot_of(views, light, noise=0.4)), views)
    np.testing.assert_allclose(corrected.shot.weights / corrected.shot.weights.mean(), light / light.mean(), atol=0.05)


def test_right_weights_stay_though_noise_would_have_them_a_little_otherwise():
    views = views_of()
    holdout = holdout_of(shot_of(views, np.ones(len(LIGHT)), noise=0.1))
    assert not np.array_equal(view_brightness(holdout.seen, views), np.ones(len(LIGHT)))
    assert corrected_of(holdout, views) is None
    assert gain_of(holdout.seen, views) < GAIN


def test_halves_that_disagree_keep_the_weights():
    views = views_of()
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    first = (rows // 2 + columns // 2) % 2 == 0
    one, other = (shot_of(views, light).measurement for light in (LIGHT, 2 - LIGHT))
    torn = replace(shot_of(views), measurement=np.where(first[..., None], one, other))
    assert gain_of(torn, views) == 0
    assert corrected_of(holdout_of(torn), views) is None


def test_one_half_that_tells_nothing_keeps_the_weights():
    views = views_of()
    shot = shot_of(views)
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    lit = (rows // 2 + columns // 2) % 2 == 0
    masks = shot.masks * np.where(lit, 1, shot.masks[:1])
    masks[:, ~lit] = shot.masks[0][~lit]  # the dark half of the board sees all masks alike
    assert gain_of(replace(shot, masks=masks.astype(np.float32)), np.repeat(views[:1], len(LIGHT), 0)) == 0


def test_standard_errors_are_those_of_repeated_noise():
    views, found, errors = views_of(), [], []
    for seed in range(40):
        noise = 0.1 * np.random.default_rng(seed).standard_normal((*SIZE, 3))
        shot = shot_of(views)
        system = LinearSystem.of(replace(shot, measurement=(shot.measurement + noise).astype(np.float32)), views)
        found.append(system.solve())
        errors.append(system.errors())
    scatter = np.std(found, axis=0, ddof=1)
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(errors), axis=0)), scatter, rtol=0.35)


def test_what_brightens_one_part_of_the_picture_alone_is_no_lamp():
    """A thing comes into view: the pixels agree with one another, the parts of the picture do not."""
    views = views_of()
    changed = views.copy()
    changed[:, 10:24, 12:30] *= (1 + 2 * (LIGHT - 1))[:, None, None, None].astype(np.float32)
    holdout = holdout_of(shot_of(changed, np.ones(len(LIGHT))))
    found = estimate(holdout, views)
    assert found.gain > GAIN
    assert found.errors_away < SETTINGS.least_errors
    assert corrected_of(holdout, views) is None
    lit = estimate(holdout_of(shot_of(views)), views)
    assert lit.errors_away > 10 * SETTINGS.least_errors


def test_an_estimate_without_any_scatter_is_no_deviation():
    assert BrightnessEstimate(np.array([1.0, 1.2]), np.zeros(2), 0.5).errors_away == 0
    assert Brightness().summary() is None


@pytest.mark.parametrize(
    ("weights", "light", "as_seen"),
    [
        ([1, 1, 1], "auto", True),
        ([0, 0.5, 0.5], "auto", True),
        ([1, 0.9, 1], "auto", False),
        ([1, 0.9, 1], "as-seen", True),
        ([1, 1, 1], "even", False),
    ],
)
def test_views_are_even_where_weights_were_told_or_where_that_is_wanted(weights, light, as_seen):
    assert BrightnessSettings(light=light).shows_as_seen(np.array(weights, np.float32)) is as_seen


def test_views_are_shown_as_bright_as_they_were_seen_and_code_to_the_same_measurement():
    views = views_of()
    holdout = holdout_of(shot_of(views))
    found = estimate(holdout, views)
    believed = relit(holdout, found)
    seen, even = (Brightness(found, found.found, as_seen) for as_seen in (True, False))
    np.testing.assert_allclose(holdout.coded(seen.shown(views)), believed.coded(even.shown(views)), rtol=1e-5)
    assert (seen.summary().views, even.summary().views) == ("as-seen", "even")
    assert seen.summary().used == found.found.tolist()


def test_another_light_is_refused():
    with pytest.raises(InputError, match="light = 'dim' in BrightnessSettings"):
        BrightnessSettings(light="dim").check()


@pytest.mark.parametrize(
    "settings",
    [{"rounds": -1}, {"least_gain": -0.1}, {"least_gain": 1.1}, {"least_gain": np.nan}, {"least_errors": np.nan}],
)
def test_settings_that_make_no_sense_are_refused(settings):
    with pytest.raises(InputError, match=f"{next(iter(settings))} = .* in BrightnessSettings"):
        BrightnessSettings(**settings).check()


@pytest.mark.parametrize("light", [np.ones(5), LIGHT])
def test_predictions_that_are_displaced_do_not_make_the_sharp_one_brighter(light):
    """All but the middle view are predicted a few pixels from where they are; detail of the middle one fits alone."""
    size, rng = (96, 120), np.random.default_rng(4)
    picture = rng.standard_normal((size[0] + 32, size[1] + 32))
    picture = gaussian_filter(picture, 0.8)
    picture = np.clip(0.5 + 0.25 * picture / picture.std(), 0, 1).astype(np.float32)

    def seen(right):
        return np.stack([picture[16:-16, 16 + x : 16 + x + size[1]] for x in right])[..., None]

    views, carried = seen([-8, -4, 0, 4, 8]), seen([-2, -1, 0, 1, 2])
    masks = (rng.random((5, *size)) < 0.4).astype(np.float32)
    measurement = np.einsum("n,nhw,nhwc->hwc", light, masks, views).astype(np.float32)
    shot = Shot(measurement, masks).check()
    sharp = view_brightness(shot, carried)
    assert sharp[2] / light[2] > 1.05
    found = estimate(holdout_of(shot), carried)
    assert np.abs(found.found - light).max() < 0.06
    assert found.is_sure(SETTINGS) == (light.min() < 1)


@pytest.mark.parametrize("cfa", [None, "RGGB"])
def test_a_card_estimates_what_the_host_does_with_the_same_bits_twice(cfa):
    pytest.importorskip("warp", reason="Warp is not installed")
    views = views_of()
    shot = shot_of(views, noise=0.01, saturated=np.arange(SIZE[0] * SIZE[1]).reshape(SIZE) % 7 == 0)
    if cfa is not None:
        shot = replace(shot, measurement=shot.measurement[..., 1:2], cfa=cfa)
    holdout = holdout_of(shot)
    here = estimate(holdout, views)
    with pretended_card() as card, working_on(CARD):
        there, again = estimate(holdout, views), estimate(holdout, views)
    assert card.of_floats["matmul"]
    np.testing.assert_allclose(there.found, here.found, rtol=1e-12)
    np.testing.assert_allclose(there.errors, here.errors, rtol=1e-9)
    assert there.gain == pytest.approx(here.gain, abs=1e-12)
    assert there.gain == again.gain
    assert np.array_equal(there.found, again.found)
    assert np.array_equal(there.errors, again.errors)
