"""What a measurement tells of its masks and its light is found and corrected; what it does not is left alone."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from gs2ci.core.errors import InputError
from gs2ci.core.records import Shot
from gs2ci.reconstruct.measurement.coding import Coding
from gs2ci.reconstruct.registration.register import RegistrationSettings, register
from tests.reconstruct.registration.warps import blurred, warped
from tests.stability.random_forms import Form

pytestmark = pytest.mark.slow


def test_nothing_wrong_changes_nothing(bench):
    shot = bench.shoot()
    found = register(shot)
    assert found.shot is shot
    assert not found.is_changed
    assert found.notes == ()


def test_off_asks_nothing(bench):
    shot = bench.shoot(stated=np.roll(bench.masks, 3, axis=2))
    assert register(shot, RegistrationSettings(mode="off")).shot is shot


@pytest.mark.parametrize("settings", [RegistrationSettings(), RegistrationSettings(mode="off")])
def test_the_frame_of_a_single_mask_is_refused(bench, settings):
    """As captures with mode = "per-mask" write them: beside all masks, of which the frame has seen one."""
    shot = replace(bench.shoot(), provenance={"mode": "per-mask", "mask_index": 2})
    with pytest.raises(InputError, match=r'single mask \(mask_index 2 of .*nothing is coded.*mode = "per-exposure"'):
        register(shot, settings)
    alone = replace(shot, masks=shot.masks[:1], weights=shot.weights[:1])
    assert register(alone, RegistrationSettings(mode="off")).shot is alone


@pytest.mark.parametrize("settings", [RegistrationSettings(), RegistrationSettings(mode="off")])
def test_light_of_the_wrong_sign_is_refused(bench, settings):
    shot = bench.shoot()
    with pytest.raises(InputError, match=r"readings of .* are negative, -.* on average.*turn their sign"):
        register(replace(shot, measurement=-shot.measurement), settings)


def test_an_offset_that_leaves_no_reading_above_zero_is_found(bench):
    shot = bench.shoot()
    offset = 3 * float(shot.measurement.max())
    found = register(replace(shot, measurement=shot.measurement - np.float32(offset)))
    assert found.misfit.black == pytest.approx(-offset, rel=0.02)


@pytest.mark.parametrize("offset", [-0.001, -0.05])
def test_the_noise_of_a_dark_frame_is_not_refused(bench, offset):
    shot = bench.shoot()
    noise = np.random.default_rng(0).normal(offset, 0.01, shot.measurement.shape).astype(np.float32)
    assert register(replace(shot, measurement=noise), RegistrationSettings(mode="off")).shot.measurement is noise


@pytest.mark.parametrize("moved", [(0.25, 0.0), (0.5, -0.35), (-3.6, 5.3), (17.0, -9.5)])
def test_a_shift_is_found_to_a_hundredth_of_a_pixel(bench, moved):
    were = warped(bench.masks, down_px=moved[0], right_px=moved[1])
    found = register(bench.shoot(were=were))
    place = found.misfit
    assert (place.down_px, place.right_px) == pytest.approx(moved, abs=0.02)
    assert found.errors["down_px"] < 0.02
    inner = np.s_[:, 20:-20, 20:-20]
    assert np.abs(found.shot.masks[inner] - were[inner]).mean() < 0.01


@pytest.mark.parametrize(("turn_deg", "scale"), [(0.3, 1.0), (-2.5, 1.0), (0.0, 1.005), (1.0, 0.975)])
def test_turn_and_scale_are_found(bench, turn_deg, scale):
    found = register(bench.shoot(were=warped(bench.masks, turn_deg=turn_deg, scale=scale)))
    place = found.misfit
    assert place.rotation_deg == pytest.approx(turn_deg, abs=0.03)
    assert 1 + place.scale == pytest.approx(scale, abs=0.0005)


@pytest.mark.parametrize(
    ("turn", "word"),
    [
        (lambda m: m[:, ::-1], "upside down"),
        (lambda m: m[:, :, ::-1], "mirrored left to right"),
        (lambda m: m[:, ::-1, ::-1], "turned by 180 degrees"),
    ],
)
def test_turned_masks_are_turned_back(bench, turn, word):
    found = register(bench.shoot(stated=turn(bench.masks)))
    assert found.orientation == word
    assert np.array_equal(found.shot.masks, bench.masks)


@pytest.mark.parametrize("seed", [20, 162, 380])
def test_masks_of_few_elements_are_not_turned_because_a_wrong_orientation_correlates_by_chance(seed):
    """Pictures of 19 x 30, 10 x 16 and 16 x 9 px, whose peaks are 4 and many times the thirtieth best."""
    assert register(Form.draw(seed).shot()).orientation == "as given"


@pytest.mark.parametrize(
    ("turn", "word"),
    [
        (lambda m: np.rot90(m, 1, (1, 2)), "turned by 90 degrees clockwise"),
        (lambda m: np.rot90(m, -1, (1, 2)), "turned by 90 degrees anticlockwise"),
        (lambda m: m.swapaxes(1, 2), "transposed"),
    ],
)
def test_square_masks_are_turned_back_by_a_right_angle(bench, turn, word):
    square = type(bench)(bench.views[:, :, :96], np.ascontiguousarray(bench.masks[:, :, :96]))
    found = register(square.shoot(stated=turn(square.masks)))
    assert found.orientation == word
    assert np.array_equal(found.shot.masks, square.masks)


def few_elements(seed):
    """Six views of 48 × 48 px, and the masks that coded them, of 24 × 24 elements."""
    rng = np.random.default_rng(seed)
    masks = (rng.random((6, 24, 24)) < 0.4).astype(np.float32).repeat(2, 1).repeat(2, 2)
    scene = gaussian_filter(rng.random((48, 48)), 2)
    scene = 0.1 + 0.8 * (scene - scene.min()) / np.ptp(scene)
    light = (masks * np.stack([np.roll(scene, k, axis=1) for k in range(6)])).sum(axis=0)
    light += rng.normal(0, 0.02, scene.shape)
    return Shot(light[..., None].astype(np.float32), masks).check()


@pytest.mark.parametrize("seed", [18, 476, 490, 1500, 1699])
def test_turned_masks_of_few_elements_that_correlate_by_chance_as_given_are_turned_back(seed):
    shot = few_elements(seed)
    stated = np.ascontiguousarray(np.rot90(shot.masks, 1, (1, 2)))
    found = register(replace(shot, masks=stated))
    assert found.orientation == "turned by 90 degrees clockwise"
    assert np.array_equal(found.shot.masks, shot.masks)


@pytest.mark.parametrize("seed", [80, 144, 444, 690, 739])
def test_other_masks_of_few_elements_that_correlate_by_chance_are_left_alone(seed):
    other = (np.random.default_rng(seed + 10**6).random((6, 24, 24)) < 0.4).astype(np.float32)
    shot = replace(few_elements(seed), masks=other.repeat(2, 1).repeat(2, 2))
    assert register(shot).shot is shot


@pytest.mark.parametrize("late", [1, 2, 5])
def test_a_list_that_begins_with_another_mask_is_put_in_order(bench, late):
    found = register(bench.shoot(stated=np.roll(bench.masks, -late, axis=0)))
    assert found.first_mask == found.summary().first_mask == 6 - late
    assert np.array_equal(found.shot.masks, bench.masks)
    assert [note.code for note in found.notes] == ["masks_begin_elsewhere"]


def test_weights_and_poses_stay_with_their_times_where_masks_are_put_in_order(bench):
    shot = bench.shoot(stated=np.roll(bench.masks, -2, axis=0))
    weights = np.linspace(0.98, 1.02, 6, dtype=np.float32)
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, 0, 3] = np.arange(6)
    found = register(replace(shot, weights=weights, telemetry_world_to_camera=poses).check())
    assert found.first_mask == 4
    assert np.array_equal(found.shot.weights, weights)
    assert np.array_equal(found.shot.telemetry_world_to_camera, poses)


def test_a_reversed_list_is_left_as_it_is(bench):
    shot = bench.shoot(stated=bench.masks[::-1])
    assert register(shot).shot is shot


def test_mirrored_masks_that_begin_with_another_are_both_turned_and_put_in_order(bench):
    found = register(bench.shoot(stated=np.roll(bench.masks[:, :, ::-1], -3, axis=0)))
    assert (found.orientation, found.first_mask) == ("mirrored left to right", 3)
    assert np.array_equal(found.shot.masks, bench.masks)


@pytest.mark.parametrize("sigma_px", [0.5, 1.0])
def test_blur_that_nobody_knew_of_is_found(bench, sigma_px):
    were = blurred(bench.masks, sigma_px)
    found = register(bench.shoot(were=were))
    assert found.summary().blur_sigma_px == pytest.approx(sigma_px, abs=0.05)
    assert np.abs(found.shot.masks - were).mean() < 0.01


@pytest.mark.parametrize("sigma_px", [0.5, 1.0, 2.0])
def test_masks_stated_softer_than_they_were_are_sharpened(bench, sigma_px):
    found = register(bench.shoot(stated=blurred(bench.masks, sigma_px).astype(np.float32)))
    assert np.abs(found.shot.masks - bench.masks).mean() < 0.02


def test_masks_are_not_restored_where_that_is_left_out(bench):
    shot = bench.shoot(stated=blurred(bench.masks, 1.0).astype(np.float32))
    off = [
        np.abs(register(shot, one).shot.masks - bench.masks).mean()
        for one in (None, RegistrationSettings(restores=False))
    ]
    assert off[1] > 2 * off[0]


def test_masks_that_are_too_soft_to_tell_what_they_were_are_said_to_be(bench):
    noise = np.random.default_rng(2).normal(0, 1e-3, bench.masks.shape)
    stated = np.clip(blurred(bench.masks, 2.0) + noise, 0, 1).astype(np.float32)
    found = register(bench.shoot(stated=stated))
    assert [note.code for note in found.notes] == ["masks_corrected", "masks_too_soft"]
    off = {name: np.abs(masks - bench.masks).mean() for name, masks in (("now", found.shot.masks), ("before", stated))}
    assert off["now"] < 0.95 * off["before"]


@pytest.mark.parametrize("sigma", [0.06, 0.12])
def test_noise_of_soft_masks_is_taken_for_no_blur_leak_or_black_level(bench, sigma):
    soft = 0.97 * blurred(bench.masks, 0.8) + 0.03
    noise = np.random.default_rng(3).normal(0, sigma, soft.shape)
    found = register(bench.shoot(were=soft, stated=np.clip(soft + noise, 0, 1).astype(np.float32)))
    assert not {"blur_px2", "leak", "black"} & {*found.errors}


@pytest.mark.parametrize("scale", [0.98, 1.02])
def test_masks_resampled_at_another_magnification_are_put_back(bench, scale):
    found = register(bench.shoot(stated=warped(bench.masks, scale=scale).astype(np.float32)))
    assert found.misfit.scale == pytest.approx(1 / scale - 1, abs=1e-3)
    assert np.abs(found.shot.masks - bench.masks)[:, 3:-3, 3:-3].mean() < 0.01


@pytest.mark.parametrize("right_px", [0.25, 0.5])
def test_masks_stated_interpolated_are_put_back(bench, right_px):
    stated = warped(bench.masks, right_px=right_px).astype(np.float32)
    found = register(bench.shoot(stated=stated))
    assert found.misfit.right_px == pytest.approx(-right_px, abs=0.02)
    assert np.abs(found.shot.masks - bench.masks)[:, 2:-2, 2:-2].mean() < 0.01


@pytest.mark.parametrize("black", [0.3, -0.3])
def test_a_black_level_is_found_and_given_back(bench, black):
    shot = bench.shoot(black=black)
    found = register(shot)
    assert found.misfit.black == pytest.approx(black, abs=0.02)
    assert np.allclose(found.shot.measurement * found.unit + found.misfit.black, shot.measurement, atol=1e-5)


def smooth_behind_wide_elements(seed, *, leak=0.0):
    """Five views of 64 × 64 px, whose neighbours predict them whatever is added to them; masks as they were drawn."""
    rng = np.random.default_rng(seed)
    scene = gaussian_filter(rng.random((64, 64)), 6)
    scene = 0.2 + 0.6 * (scene - scene.min()) / np.ptp(scene)
    masks = (rng.random((5, 16, 16)) < 0.4).astype(float).repeat(4, 1).repeat(4, 2)
    views = np.stack([np.roll(scene, k, axis=1) for k in range(5)])
    light = (((1 - leak) * masks + leak) * views).sum(axis=0) + rng.normal(0, 0.02, scene.shape)
    return Shot(light[..., None].astype(np.float32), masks.astype(np.float32)).check()


@pytest.mark.parametrize("seed", range(4))
def test_a_black_level_behind_the_wide_elements_of_a_small_picture_is_found(seed):
    shot = smooth_behind_wide_elements(seed)
    assert not register(shot).is_changed
    found = register(replace(shot, measurement=shot.measurement + np.float32(0.15)))
    assert found.misfit.black == pytest.approx(0.15, abs=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_leak_and_black_level_that_only_together_are_uncertain_are_corrected_within_their_errors(seed):
    shot = smooth_behind_wide_elements(seed, leak=0.06)
    found = register(replace(shot, measurement=shot.measurement + np.float32(0.1)))
    assert found.is_changed
    for name, value, true in (("leak", found.misfit.leak, 0.06), ("black", found.misfit.black, 0.1)):
        assert abs(value - true) < 4 * found.errors.get(name, np.inf)


@pytest.mark.parametrize("unit", [1e-3, 1e3, 1e6])
def test_a_unit_off_by_a_power_of_ten_is_found(bench, unit):
    found = register(bench.shoot(unit=unit))
    assert found.unit == pytest.approx(unit)
    given = found.shot.measurement * found.unit + found.misfit.black
    assert np.allclose(given / unit, bench.shoot().measurement, atol=1e-4)


def test_a_dark_scene_is_dark_if_its_unit_is_stated_and_readings_brighter_than_white_still_are_none(bench):
    dark, bright = (replace(bench.shoot(unit=unit), provenance={"unit_stated": True}) for unit in (1e-3, 1e3))
    assert register(dark).unit == 1.0
    assert register(replace(dark, provenance={"unit_stated": False})).unit == pytest.approx(1e-3)
    assert register(bright).unit == pytest.approx(1e3)


def test_counts_keep_the_range_of_their_bits(bench):
    shot = bench.shoot(unit=4095.0)
    assert register(replace(shot, measurement=np.rint(shot.measurement))).unit == 4095.0


@pytest.mark.parametrize("share", [0.8, 0.5])
def test_masks_stated_dimmer_are_opened(bench, share):
    found = register(bench.shoot(stated=share * bench.masks))
    assert found.open_level == pytest.approx(share)
    assert np.allclose(found.shot.masks, bench.masks)


def test_light_through_closed_elements_is_found(bench):
    found = register(bench.shoot(were=0.95 * bench.masks + 0.05))
    assert found.misfit.leak == pytest.approx(0.05, abs=0.01)


def test_clipping_that_nobody_told_of_is_found(bench):
    shot = bench.shoot()
    level = np.quantile(shot.measurement.max(axis=2), 0.6)
    clipped = replace(shot, measurement=np.minimum(shot.measurement, np.float32(level)))
    found = register(clipped)
    assert np.array_equal(found.shot.saturated, (shot.measurement >= level).any(axis=2))
    assert found.clipped_share == pytest.approx(0.4, abs=0.01)
    assert found.misfit.black == found.misfit.leak == 0.0


def test_told_clipping_stays_as_it_was_told(bench):
    shot = bench.shoot()
    told = np.zeros(shot.size, bool)
    assert register(replace(shot, saturated=told)).shot.saturated is told


def test_several_things_at_once_are_told_apart(bench):
    were = 0.97 * blurred(warped(bench.masks, down_px=0.5, right_px=-0.5, turn_deg=0.2), 0.7) + 0.03
    found = register(bench.shoot(were=were, noise=0.02))
    place = found.misfit
    assert (place.down_px, place.right_px) == pytest.approx((0.5, -0.5), abs=0.04)
    assert place.rotation_deg == pytest.approx(0.2, abs=0.06)
    assert np.abs(found.shot.masks - were)[:, 4:-4, 4:-4].mean() < 0.02


def test_a_pattern_that_begins_anew_is_recognised_at_the_rim(bench):
    were = np.roll(bench.masks, 9, axis=2)
    found = register(bench.shoot(were=were))
    assert np.abs(found.shot.masks - were).mean() < 0.01
    assert any("repeats periodically" in note.sentence for note in found.notes)
    assert found.averaged is None


def test_an_unknown_rim_is_taken_to_be_grey(bench):
    rng = np.random.default_rng(8)
    were = np.roll(bench.masks, 9, axis=2)
    were[:, :, :9] = rng.random(were[:, :, :9].shape) < 0.33
    found = register(bench.shoot(were=were))
    assert np.allclose(found.shot.masks[:, :, 10:], were[:, :, 10:], atol=0.02)
    band = found.shot.masks[:, :, :8]
    assert np.allclose(band, band[:, :1, :1])
    assert any("masks are not known there" in note.sentence for note in found.notes)
    assert np.array_equal(found.averaged, np.broadcast_to(np.arange(were.shape[2]) < 9, were.shape[1:]))


@pytest.mark.parametrize("what", ["other masks", "dark", "noise", "even sum", "small"])
def test_what_cannot_be_told_is_left_alone(bench, what):
    rng = np.random.default_rng(11)
    shot = bench.shoot()
    if what == "other masks":
        shot = bench.shoot(stated=(rng.random(bench.masks.shape) < 0.33).astype(np.float32))
    elif what == "dark":
        shot = replace(shot, measurement=np.zeros_like(shot.measurement))
    elif what == "noise":
        shot = replace(shot, measurement=rng.normal(0, 1, shot.measurement.shape).astype(np.float32))
    elif what == "even sum":
        half = bench.masks[:3]
        masks = np.concatenate([half, 1 - half])
        shot = bench.shoot(were=masks, stated=masks)
    else:
        shot = replace(
            shot, measurement=shot.measurement[:16, :16], masks=shot.masks[:, :16, :16], truth=type(shot.truth)()
        )
    found = register(shot)
    assert found.shot is shot


def test_sixty_four_views_a_mosaic_and_grey_masks_are_registered_as_well(bench):
    rng = np.random.default_rng(12)
    grey = rng.random(bench.masks.shape).astype(np.float32)
    moved = warped(grey, right_px=1.4)
    found = register(bench.shoot(were=moved, stated=grey))
    assert found.misfit.right_px == pytest.approx(1.4, abs=0.03)
    masks = (rng.random((64, 96, 112)) < 0.3).astype(np.float32)
    many = type(bench)(np.repeat(bench.views[:1], 64, axis=0), masks)
    found = register(many.shoot(were=warped(masks, down_px=-0.6)))
    assert found.misfit.down_px == pytest.approx(-0.6, abs=0.03)
    colour = bench.shoot(were=warped(bench.masks, down_px=0.7))
    light, mosaic = colour.measurement, np.zeros((*colour.size, 1), np.float32)
    for (row, column), channel in {(0, 0): 0, (0, 1): 1, (1, 0): 1, (1, 1): 2}.items():
        mosaic[row::2, column::2, 0] = light[row::2, column::2, channel]
    found = register(replace(colour, measurement=mosaic, cfa="RGGB").check())
    assert found.misfit.down_px == pytest.approx(0.7, abs=0.04)


def test_the_summary_is_plain_and_whole(bench):
    found = register(bench.shoot(were=warped(bench.masks, down_px=1.5)))
    summary = json.loads(json.dumps(asdict(found.summary())))
    assert summary["placement"]["down_px"] == pytest.approx(1.5, abs=0.02)
    assert summary["largest_displacement_px"] == pytest.approx(1.5, abs=0.05)
    assert set(summary["standard_errors"]) == {"down_px", "right_px"}
    assert "black" in summary["not_let_in"]


def test_the_corrected_masks_explain_the_readings(bench):
    shot = bench.shoot(were=warped(bench.masks, turn_deg=0.5), noise=0.0)
    found = register(shot)
    views = torch.from_numpy(bench.views.astype(np.float32))
    left = {
        name: np.abs(Coding.of(one).forward(views).numpy() - shot.measurement).mean()
        for name, one in (("stated", shot), ("registered", found.shot))
    }
    assert left["registered"] < 0.1 * left["stated"]


@pytest.mark.parametrize("settings", [RegistrationSettings(mode="on"), RegistrationSettings(most_shift_px=-1)])
def test_settings_that_make_no_sense_are_refused(bench, settings):
    with pytest.raises(InputError, match=" in RegistrationSettings"):
        register(bench.shoot(), settings)


@pytest.mark.parametrize(
    "bend",
    [
        lambda y, total: 4 * (np.clip(y, 0, 4) / 4) ** (1 / 2.2),
        lambda y, total: y / np.maximum(total, 1),
        lambda y, total: np.mod(np.maximum(y, 0), 1.5),
    ],
)
def test_readings_that_bend_are_not_explained_by_a_leak(bench, bend):
    """An invented leak of 0.14 to 0.38 was applied, and the advice was to measure the masks again."""
    shot = bench.shoot()
    total = shot.masks.sum(axis=0)[..., None]
    spoiled = replace(shot, measurement=bend(shot.measurement.astype(np.float64), total).astype(np.float32))
    found = register(spoiled)
    assert "readings_bend" in [note.code for note in found.notes]
    assert (found.misfit.leak, found.misfit.black) == (0, 0)
