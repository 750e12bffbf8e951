from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gs2ci.core.findings import Code
from gs2ci.core.records import CFA_PATTERNS, Shot
from gs2ci.reconstruct.measurement.coding import cfa_channels
from gs2ci.reconstruct.measurement.doubts import doubt_about_lamps, doubts_about, doubts_about_result
from gs2ci.reconstruct.measurement.holdout import Holdout
from tests.core.test_mosaics import coded


def found_in(shot):
    return {note.code: note for note in doubts_about(shot)}


@pytest.fixture
def holdout(smooth_shot):
    return Holdout.of(smooth_shot, 0.1, seed=0)


def test_an_ordinary_shot_raises_no_doubt_but_that_some_pixels_stay_dark(smooth_shot):
    (only,) = doubts_about(smooth_shot)
    assert only.code is Code.UNOPENED_PIXELS


def test_readings_beyond_white_are_told(smooth_shot):
    assert Code.BRIGHTER_THAN_WHITE in found_in(replace(smooth_shot, masks=0.5 * smooth_shot.masks))


def test_a_dark_level_subtracted_twice_is_told(smooth_shot):
    measurement = smooth_shot.measurement - np.float32(0.2)
    assert Code.DARKER_THAN_DARK in found_in(replace(smooth_shot, measurement=measurement))


def test_one_lamp_is_not_worth_a_word(smooth_shot):
    measurement = smooth_shot.measurement.copy()
    measurement[3, 4:8] = 20
    assert Code.BRIGHTER_THAN_WHITE not in found_in(replace(smooth_shot, measurement=measurement))


def test_a_lamp_that_outshines_the_scene_is_told_though_it_is_small(smooth_shot):
    """Nine pixels of 20 times white in a dark scene: a share of the picture that says nothing."""
    views = smooth_shot.truth.views / 20
    views[:, 10:13, 20:23] = 20
    measured = (smooth_shot.masks[..., None] * views).sum(axis=0)
    (told,) = doubt_about_lamps(replace(smooth_shot, measurement=measured))
    assert told.code is Code.LAMP_IN_PICTURE
    assert told.figures["share"] < 0.01
    assert told.figures["light"] > 0.5
    assert doubt_about_lamps(smooth_shot) == ()
    assert doubt_about_lamps(replace(smooth_shot, measurement=0 * smooth_shot.measurement)) == ()
    half_masks = replace(smooth_shot, masks=0.5 * smooth_shot.masks)
    assert doubt_about_lamps(half_masks) == ()
    assert Code.BRIGHTER_THAN_WHITE in found_in(half_masks)


@pytest.mark.parametrize(("cfa", "taken"), [(None, "one colour"), ("GRBG", "GRBG"), ("RGGB", None), ("BGGR", None)])
def test_a_mosaic_that_is_taken_for_another_is_told(cfa, taken):
    readings, _ = coded(3, "RGGB")
    masks = (np.random.default_rng(3).random((6, 72, 96)) < 0.4).astype(np.float32)  # those that `coded` draws
    told = found_in(Shot(readings[..., None], masks, cfa=cfa))
    assert (Code.OTHER_MOSAIC in told) == (taken is not None)
    if taken is not None:
        assert told[Code.OTHER_MOSAIC].sentence.startswith(
            f"The readings look like a colour mosaic RGGB or BGGR, but were taken as {taken}:"
        )


def test_a_measurement_of_another_unit_is_told(smooth_shot):
    found = found_in(replace(smooth_shot, measurement=smooth_shot.measurement / np.float32(255)))
    assert found[Code.VERY_DARK].figures["share"] < 0.02


def test_wrong_weights_are_told_and_right_ones_are_not(smooth_shot):
    truth = smooth_shot.truth.views
    weights = np.array([1, 0.6, 1, 1], np.float32)
    measured = (weights[:, None, None, None] * smooth_shot.masks[..., None] * truth).sum(axis=0)
    assert Code.UNEVEN_VIEWS in found_in(replace(smooth_shot, measurement=measured))
    assert Code.UNEVEN_VIEWS not in found_in(replace(smooth_shot, measurement=measured, weights=weights))


@pytest.mark.parametrize(("dimmed", "told"), [(1.0, False), (0.6, True)])
@pytest.mark.parametrize("seed", range(3))
def test_wide_elements_before_a_textured_scene_are_no_uneven_light(seed, dimmed, told):
    """Behind elements of 3 px neighbours err alike, so that a scene's texture weighs more than single pixels would."""
    rng = np.random.default_rng(seed)
    texture = gaussian_filter(rng.standard_normal((120, 144)), 2.0)
    view = np.clip(0.4 + 0.25 * texture / texture.std(), 0, 1)[..., None]
    masks = np.kron(rng.random((8, 40, 48)) < 0.25, np.ones((1, 3, 3)))
    light = np.ones(8)
    light[2] = dimmed
    measured = (light[:, None, None, None] * masks[..., None] * view).sum(axis=0)
    shot = Shot(measured.astype(np.float32), masks.astype(np.float32)).check()
    assert (Code.UNEVEN_VIEWS in found_in(shot)) == told


def test_a_view_without_light_is_told_as_dark_and_not_as_negative(smooth_shot):
    weights = np.array([1, 0, 1, 1], np.float32)
    measured = (weights[:, None, None, None] * smooth_shot.masks[..., None] * smooth_shot.truth.views).sum(axis=0)
    measured -= np.float32(0.01) * smooth_shot.masks[1][..., None]
    said = found_in(replace(smooth_shot, measurement=measured))[Code.UNEVEN_VIEWS]
    assert said.figures["least"] == 0
    assert said.figures["most"] > 0.9


def test_masks_of_whole_rows_do_not_make_light_negative(smooth_shot):
    """Where a scene is bright above and dark below, the regression wants a negative view to make the rest dark."""
    masks, measured = np.zeros_like(smooth_shot.masks), np.zeros_like(smooth_shot.measurement)
    for mask, rows in zip(masks, (slice(0, 16), slice(0, 12), slice(8, 24), slice(24, None)), strict=True):
        mask[rows] = 1
    measured[:8] = 2
    assert Code.UNEVEN_VIEWS not in found_in(replace(smooth_shot, masks=masks, measurement=measured))


def test_brightness_is_not_compared_behind_masks_that_do_not_tell_views_apart(smooth_shot):
    masks = np.repeat(smooth_shot.masks[:1], 4, axis=0)
    found = found_in(replace(smooth_shot, masks=masks))
    assert Code.SAME_MASKS in found
    assert Code.UNEVEN_VIEWS not in found


def test_views_with_the_same_mask_are_named_and_those_without_light_are_not_among_them(smooth_shot):
    masks = smooth_shot.masks.copy()
    assert Code.MASKS_REPEATED not in found_in(smooth_shot)
    masks[2] = masks[0]
    assert found_in(replace(smooth_shot, masks=masks))[Code.MASKS_REPEATED].figures["views"] == [0, 2]
    weights = np.array([1, 1, 0, 1], np.float32)
    assert Code.MASKS_REPEATED not in found_in(replace(smooth_shot, masks=masks, weights=weights))
    masks[:] = masks[0]
    assert Code.MASKS_REPEATED not in found_in(replace(smooth_shot, masks=masks))


@pytest.mark.parametrize(("open_share", "named"), [(0.1, False), (0.5, False), (0.75, False), (0.98, True)])
def test_masks_that_differ_little_from_view_to_view_are_named(smooth_shot, open_share, named):
    masks = (np.random.default_rng(0).random(smooth_shot.masks.shape) < open_share).astype(np.float32)
    found = found_in(replace(smooth_shot, masks=masks))
    assert (Code.MASKS_DIFFER_LITTLE in found) == named
    if named:
        assert found[Code.MASKS_DIFFER_LITTLE].figures["share"] == pytest.approx(0.12, abs=0.03)


def test_pairs_of_complementary_masks_are_named_with_what_they_leave_open(smooth_shot):
    """Two pairs each pass all light once: what one pair is brighter by than the other leaves no trace."""
    drawn = (np.random.default_rng(0).random((2, *smooth_shot.size)) < 0.5).astype(np.float32)
    pairs = np.stack([drawn, 1 - drawn], axis=1).reshape(4, *smooth_shot.size)
    assert found_in(replace(smooth_shot, masks=pairs))[Code.MASKS_IN_PAIRS].figures == {"untold": 1, "of": 4}
    pairs[0, 3] = 0  # a row that was never open tells them apart
    assert Code.MASKS_IN_PAIRS not in found_in(replace(smooth_shot, masks=pairs))
    for shares in ([1, 1, 1, 1], [1, 1, 0, 1], [1, 1, 1e-4, 1]):  # a view without light is no pair
        dim = smooth_shot.masks * (np.array(shares) > 0)[:, None, None]
        shot = replace(smooth_shot, masks=dim.astype(np.float32), weights=np.array(shares, np.float32))
        assert Code.MASKS_IN_PAIRS not in found_in(shot)


def test_a_view_that_hardly_any_light_reached_is_named(smooth_shot):
    weights = np.array([1, 1, 1e-4, 1], np.float32)
    assert found_in(replace(smooth_shot, weights=weights))[Code.FAINT_VIEWS].figures["views"] == [2]


def test_a_picture_that_is_mostly_dark_is_told(smooth_shot):
    masks = smooth_shot.masks.copy()
    masks[:, 12:] = 0
    assert Code.MOSTLY_UNOPENED in found_in(replace(smooth_shot, masks=masks))


def test_views_that_explain_the_measurement_raise_no_doubt(holdout, smooth_shot):
    assert doubts_about_result(holdout, smooth_shot.truth.views) == ()


def test_views_that_explain_no_more_than_grey_are_told(holdout, smooth_shot):
    grey = np.broadcast_to(smooth_shot.truth.views.mean(axis=(0, 1, 2)), smooth_shot.truth.views.shape)
    (doubt,) = doubts_about_result(holdout, np.ascontiguousarray(grey))
    assert doubt.code is Code.LITTLE_EXPLAINED


def test_without_held_out_pixels_nothing_is_said_of_the_result(smooth_shot):
    nobody = Holdout(smooth_shot, np.zeros(smooth_shot.size, bool))
    assert nobody.grey_rms() is None
    assert doubts_about_result(nobody, smooth_shot.truth.views) == ()


def test_the_best_grey_leaves_nothing_of_a_grey_scene(smooth_shot):
    measurement = 0.3 * smooth_shot.masks.sum(axis=0)[..., None].repeat(3, axis=2).astype(np.float32)
    shot = replace(smooth_shot, measurement=measurement)
    assert Holdout.of(shot, 0.1, seed=0).grey_rms() == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("cfa", CFA_PATTERNS)
def test_the_best_colour_leaves_nothing_of_an_evenly_coloured_scene_behind_a_mosaic(smooth_shot, cfa):
    seen = np.array([0.8, 0.3, 0.1], np.float32)[cfa_channels(cfa, smooth_shot.size).numpy()]
    mosaic = replace(smooth_shot, measurement=(seen * smooth_shot.masks.sum(axis=0))[..., None], cfa=cfa)
    assert Holdout.of(mosaic, 0.1, seed=0).grey_rms() == pytest.approx(0, abs=1e-6)


def test_views_of_a_coloured_mosaic_that_explain_no_more_than_one_colour_are_told(smooth_shot):
    tint = np.array([0.9, 0.3, 0.1], np.float32)
    views = smooth_shot.truth.views * tint
    seen = np.take_along_axis(
        (smooth_shot.masks[..., None] * views).sum(axis=0), cfa_channels("RGGB", smooth_shot.size).numpy()[..., None], 2
    )
    holdout = Holdout.of(replace(smooth_shot, measurement=seen, cfa="RGGB"), 0.1, seed=0)
    even = np.broadcast_to(views.mean(axis=(0, 1, 2)), views.shape)
    (doubt,) = doubts_about_result(holdout, np.ascontiguousarray(even))
    assert doubt.code is Code.LITTLE_EXPLAINED
    assert doubts_about_result(holdout, views) == ()
