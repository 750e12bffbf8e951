"""Full scales are found in the usual units, and what no unit explains is refused."""

import numpy as np
import pytest

from gs2ci.core.errors import InputError
from gs2ci.core.foreign.options import ImportOptions


@pytest.mark.parametrize("full", [1, 255, 1023, 4095, 16383, 65535])
def test_counts_per_view_are_recognised_without_truth(scene, take, full):
    made = scene(n=8, height=40, width=50)
    shot = take(meas=made.meas * full, mask=made.masks).shots[0]
    assert np.allclose(shot.measurement, made.meas, rtol=1e-6)
    assert shot.provenance["full_scale"] == full


# Not 4095: the mean of eight 12-bit readings looks like 10-bit counts, and no number can tell which it is.
@pytest.mark.parametrize("full", [1, 255])
def test_the_mean_over_the_masks_is_recognised(scene, take, full):
    made = scene(n=8, height=40, width=50)
    shot = take(meas=made.meas * full / 8, mask=made.masks).shots[0]
    assert np.allclose(shot.measurement, made.meas, rtol=1e-6)


def test_a_measurement_normalised_to_its_own_maximum_is_recognised(scene, take, said):
    made = scene(n=8, height=40, width=50)
    imported = take(meas=made.meas / made.meas.max(), mask=made.masks)
    assert said(imported, "own maximum")
    assert imported.shots[0].measurement.max() == pytest.approx(made.meas.max(), rel=0.5)


def test_a_camera_whose_range_holds_all_masks_is_recognised(scene, take, said):
    made = scene(n=10, height=40, width=50)
    meas = np.minimum(np.rint(made.meas * 255 / 5.8), 254).astype(np.uint8)
    imported = take(meas=meas, mask=made.masks)
    assert said(imported, "normalised per exposure")
    assert imported.shots[0].measurement.mean() == pytest.approx(made.meas.mean(), rel=0.25)


def test_the_truth_settles_the_scale_and_usual_values_are_snapped_to(scene, take):
    made = scene()
    near = take(meas=made.meas * 255.3, mask=made.masks, truth=made.views).shots[0]
    assert near.provenance["full_scale"] == 255
    odd = take(meas=made.meas * 37, mask=made.masks, truth=made.views).shots[0]
    assert odd.provenance["full_scale"] == pytest.approx(37)


@pytest.mark.parametrize("factor", [4.0, 1e7])
def test_a_range_that_no_scale_explains_is_passed_on_where_the_pattern_shows(scene, take, said, factor):
    made = scene(n=8, height=40, width=50)
    imported = take(meas=made.meas * factor, mask=made.masks)
    assert said(imported, "per open mask, which no usual scale explains")
    assert np.allclose(imported.shots[0].measurement, made.meas * factor)


def test_a_range_that_no_scale_explains_is_refused_where_no_pattern_shows(scene, take):
    made, other = scene(n=8, height=40, width=50), scene(n=8, height=40, width=50, seed=4)
    with pytest.raises(InputError, match=r"key 'meas'.*no usual scale explains.*--scale"):
        take(meas=made.meas * 1e7, mask=other.masks)


def test_counts_under_moved_masks_keep_their_scale(scene, take):
    made = scene(n=8, height=60, width=70, ones=0.25)
    counts = np.rint(255 * made.meas).astype(np.uint16)
    shot = take(meas=counts, mask=np.roll(made.masks, 3, axis=2)).shots[0]
    assert shot.provenance["full_scale"] == 255


def test_a_quarter_of_the_masks_does_not_explain_the_measurement(scene, take):
    made = scene(n=8, height=40, width=50)
    with pytest.raises(InputError, match="no usual scale explains"):
        take(meas=made.meas, mask=made.masks[:2])


def test_what_the_user_says_wins(scene, take, said):
    made = scene()
    shot = take(ImportOptions(scale=50.0, offset=3.0), meas=made.meas * 50 + 3, mask=made.masks).shots[0]
    assert np.allclose(shot.measurement, made.meas, atol=1e-6)
    warned = take(ImportOptions(scale=2.0), meas=made.meas, mask=made.masks, truth=made.views)
    assert said(warned, "the truth asks for --scale 1")
    for bad in (0.0, -1.0, float("nan")):
        with pytest.raises(InputError, match="--scale"):
            take(ImportOptions(scale=bad), meas=made.meas, mask=made.masks)


def test_a_measurement_without_light_is_taken_as_it_is(scene, take, said):
    made = scene()
    imported = take(meas=np.zeros_like(made.meas), mask=made.masks)
    assert said(imported, "zero everywhere")
    assert not imported.shots[0].measurement.any()


def test_a_constant_measurement_is_taken(scene, take):
    made = scene()
    assert take(meas=np.ones_like(made.meas), mask=made.masks).shots[0].measurement.max() == 1


def test_negative_readings_ask_for_an_offset_where_no_pattern_shows(scene, take):
    made, other = scene(), scene(seed=3)
    with pytest.raises(InputError, match=r"no light gives.*--offset"):
        take(meas=made.meas - 1.0, mask=other.masks)
    noisy = made.meas + np.random.default_rng(0).normal(0, 0.005, made.meas.shape)
    assert take(meas=noisy, mask=made.masks).shots[0].measurement.min() < 0


def test_negative_readings_are_passed_on_where_the_pattern_shows(scene, take):
    made = scene()
    assert take(meas=made.meas - 0.3, mask=made.masks).shots[0].measurement.min() < -0.2


def test_light_behind_closed_masks_hints_at_an_offset(scene, take, said):
    made = scene(n=3, ones=0.3)
    assert said(take(meas=made.meas + 0.2, mask=made.masks), "--offset 0.2")
    # Counts are named to the last digit, so that what is proposed can be typed.
    counts = np.rint(made.meas * 4000 + 12345).astype(np.uint16)
    assert said(take(meas=counts, mask=made.masks), "--offset 12345 ")
    assert not said(take(meas=made.meas, mask=made.masks), "--offset")


@pytest.mark.parametrize("high", [1, 113, 255])
def test_masks_are_read_in_their_own_unit(scene, take, said, high):
    made = scene()
    imported = take(meas=made.meas, mask=made.masks * np.uint8(high))
    assert np.array_equal(imported.shots[0].masks, made.masks)
    assert said(imported, "binary")


def test_grey_masks_keep_their_grey(scene, take, said):
    made = scene()
    grey = made.masks * 0.9 + 0.05
    grey[0, 0, 0] = 1.02
    imported = take(meas=made.meas, mask=grey)
    assert said(imported, "grey")
    assert said(imported, "1 values above fully open")
    assert imported.shots[0].masks[0, 1, 1] == np.float32(grey[0, 1, 1])
    assert imported.shots[0].masks.max() == 1


def test_boolean_masks_are_masks(scene, take):
    made = scene()
    assert np.array_equal(take(meas=made.meas, mask=made.masks.astype(bool)).shots[0].masks, made.masks)


def test_a_mask_scale_that_is_too_small_is_refused(scene, take):
    made = scene()
    shot = take(ImportOptions(mask_scale=200.0), meas=made.meas / 2, mask=made.masks * 100.0).shots[0]
    assert shot.masks.max() == 0.5
    for bad in (50.0, 0.0, float("nan")):
        with pytest.raises(InputError, match="--mask-scale"):
            take(ImportOptions(mask_scale=bad), meas=made.meas, mask=made.masks * 100.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m * 2 - 1, r"key 'mask': masks are negative at \d+ places, down to -1"),
        (lambda m: m * 0, "all masks are zero"),
        (lambda m: np.where(m > 0, np.nan, m), "NaN, infinite or far too large"),
        (lambda m: m * 1e300, "NaN, infinite or far too large"),
    ],
)
def test_masks_that_are_no_transmissions_are_refused(scene, take, change, message):
    made = scene()
    with pytest.raises(InputError, match=message):
        take(meas=made.meas, mask=change(made.masks.astype(float)))


def test_blank_and_repeated_masks_are_named(scene, take, said):
    made = scene(n=5)
    made.masks[1] = 0
    made.masks[3] = made.masks[4] = made.masks[2]
    meas = np.einsum("nhw,nhwc->hwc", made.masks, made.views / 255.0)
    imported = take(meas=meas, mask=made.masks)
    assert said(imported, "WARNING: masks [1] never open")
    assert said(imported, "WARNING: masks [2, 3, 4] are identical")


def test_a_white_frame_among_the_masks_is_named(scene, take, said):
    """Calibrations end with one; it was taken for a mask, and readings "grow 1.25 times as fast as the masks open"."""
    made = scene(n=4)
    with_white = np.concatenate([made.masks, np.ones((1, 24, 32), np.uint8)])
    assert said(take(meas=made.meas, mask=with_white), "WARNING: masks [4] are closed nowhere")
    assert not said(take(meas=made.meas, mask=made.masks), "closed nowhere")
    open_ = np.ones((2, 24, 32), np.uint8)
    assert not said(take(meas=2 * made.views[0] / 255.0, mask=open_), "closed nowhere")


@pytest.mark.parametrize("factor", [1 / 255, 1.0, 4095 / 255])
def test_true_views_are_read_in_their_own_unit(scene, take, factor):
    made = scene()
    shot = take(meas=made.meas, mask=made.masks, truth=made.views * factor).shots[0]
    assert np.allclose(shot.truth.views, made.views / 255, atol=1e-6)


@pytest.mark.parametrize("change", [lambda v: v * np.nan, lambda v: -v, lambda v: v * 1e6])
def test_true_views_that_are_no_light_are_refused(scene, take, change):
    made = scene()
    with pytest.raises(InputError, match=r"key 'truth'.*--truth-key none"):
        take(meas=made.meas, mask=made.masks, truth=change(made.views.astype(float)))


def test_true_views_with_a_lamp_brighter_than_white_keep_their_full_scale(scene, take, said):
    """The views are made in full scales of one view, and a lamp in them is twenty times as bright as white."""
    made = scene(height=48, width=48)
    views = 0.1 * made.views / 255.0
    views[:, 20:24, 10:14] = 20.0
    meas = np.einsum("nhw,nhwc->hwc", made.masks, views)
    imported = take(meas=meas, mask=made.masks, truth=views)
    assert said(imported, "truth: full scale 1")
    assert imported.shots[0].provenance["full_scale"] == 1
    assert np.allclose(imported.shots[0].truth.views, views)


@pytest.mark.parametrize(
    ("options", "with_truth", "stated"),
    [(None, False, False), (None, True, True), (ImportOptions(scale=1.0), False, True)],
)
def test_a_unit_counts_as_stated_if_the_user_or_the_truth_states_it(scene, take, options, with_truth, stated):
    made = scene(n=8, height=40, width=50)
    truth = {"truth": made.views} if with_truth else {}
    assert take(options, meas=made.meas, mask=made.masks, **truth).shots[0].provenance["unit_stated"] is stated


def hot(values, where, reading):
    values = np.array(values, float)
    values[where] = reading
    return values


@pytest.mark.parametrize(
    ("where", "reading"), [(np.s_[:, 20], 3000), (np.s_[10], 4095), (np.s_[::9, ::9], 3900)], ids=str
)
def test_hot_columns_rows_and_pixels_leave_the_scale_as_it_is(scene, take, where, reading):
    """A column at 2600 of counts around 1000 raised it by 4."""
    made = scene(height=48, width=64, channels=1)
    counts = np.rint(600 * made.meas[..., 0])
    right = take(meas=counts, masks=made.masks).shots[0].provenance["full_scale"]
    shot = take(meas=hot(counts, where, reading), masks=made.masks).shots[0]
    assert shot.provenance["full_scale"] == right == 1023


def test_pixels_that_are_hot_in_all_masks_do_not_say_what_open_is(scene, take, said):
    """One pixel of 65535 among masks of 3000 made them 2 % open, and the scale 14 bits instead of 10."""
    made = scene(n=8, height=48, width=64, channels=1)
    for where in (np.s_[:, 5, 7], np.s_[:, :, 20]):
        imported = take(meas=np.rint(600 * made.meas), masks=hot(3000.0 * made.masks, where, 65535))
        assert np.array_equal(np.delete(imported.shots[0].masks, (7, 20), 2), np.delete(made.masks, (7, 20), 2))
        assert said(imported, "above fully open, up to 65535, were set to 1")
    dead = hot(made.masks, np.s_[3, 5, 7], 40.0)
    assert np.array_equal(take(meas=made.meas, masks=dead).shots[0].masks, made.masks | (dead > 1))


def test_masks_that_open_hardly_anywhere_are_no_hot_pixels(scene, take):
    masks = np.zeros((4, 48, 64), np.uint8)
    masks[np.arange(4), np.arange(4) + 9, 30] = 200
    assert take(meas=masks.sum(0) / 200.0, masks=masks).shots[0].masks.max() == 1


def test_calibrated_masks_may_lie_below_zero_by_noise(scene, take, said):
    """(frame - dark) / (white - dark) does behind closed elements; they were refused."""
    made = scene(n=8)
    noisy = made.masks + np.random.default_rng(0).normal(0, 0.008, made.masks.shape)
    imported = take(meas=made.meas, masks=noisy)
    assert said(imported, "values below 0, down to -0.0")
    assert np.array_equal(imported.shots[0].masks, np.clip(noisy, 0, 1).astype(np.float32))
